"""The command line as ``python -m gtau``."""

from gtau.cli import main

main()
