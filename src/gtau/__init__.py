"""gtau: identify drive gains and dynamic parameters of serial and parallel robots from logs."""

import sys

import lazy_loader

__version__ = "0.1.0"
# imports a name of __init__.pyi when it is first used, so that ``import gtau`` stays light
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if (_ipython := sys.modules.get("IPython")) and (_shell := _ipython.get_ipython()):
    from gtau.ipython import register as _register

    _register(_shell)
