"""The compiled loops: cached where a folder can be written to, and imported only to evaluate something."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from gtau.model import kernel
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics


def test_without_a_folder_for_the_cache_the_loops_are_compiled_anyway(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def njit(*signature: Any, cache: bool = False, **options: Any) -> Any:
        tried.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'twice': no locator available for file 'kernel.py'")
        return original(*signature, **options)

    original = kernel.njit
    monkeypatch.setattr(kernel, "njit", njit)
    assert kernel._compiled()(lambda x: 2 * x)(21) == 42
    assert tried == [True, False]


def test_help_needs_no_numba() -> None:
    code = (
        "import runpy, sys\n"
        "sys.argv = ['gtau', '--help']\n"
        "try:\n    runpy.run_module('gtau', run_name='__main__')\n"
        "except SystemExit:\n    pass\n"
        "print({'numba', 'llvmlite'} & set(sys.modules))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("set()\n")


def test_paths_of_coupled_joints_do_not_depend_on_what_memory_held() -> None:
    """Their condition number is a constant, which no instruction of the step computes."""
    model = InverseDynamics(load_robot("staubli-tx40"))
    rng = np.random.default_rng(0)
    q = 0.1 * rng.normal(size=(6, 40))
    for _ in range(30):
        poison = [np.full((rows, 200), np.nan) for rows in range(1, 30)]
        del poison
        assert np.isfinite(model.path(q)).all()
