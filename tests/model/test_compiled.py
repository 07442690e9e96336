"""The machine code of the compiled loops on disk: found again, refused where damaged, not kept where it cannot be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gtau.model.interpreter import compiled

SOURCE = Path(compiled.__file__).parent


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_machine_code_is_found_again_and_not_where_it_is_damaged(folder: Path) -> None:
    assert not compiled.is_compiled()
    compiled._keep(b"machine code")
    assert compiled.is_compiled()
    assert compiled._kept() == b"machine code"
    (file,) = folder.iterdir()
    for damaged in (file.read_bytes()[:-1], b"", file.read_bytes() + b"0"):
        file.write_bytes(damaged)
        assert compiled._kept() is None


def test_without_a_folder_for_it_machine_code_is_not_kept(folder: Path) -> None:
    folder.write_text("a file is in the way")
    compiled._keep(b"machine code")
    assert not compiled.is_compiled()


def test_it_is_kept_in_the_users_cache_where_the_package_is_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "package").write_text("a file is in the way")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(compiled, "edition", lambda: "0")
    monkeypatch.setattr(compiled, "_HERE", tmp_path / "package")
    compiled._keep(b"machine code")
    assert [file.name for file in (tmp_path / "home" / "gtau").iterdir()] == ["loops-0.o"]
    assert compiled._kept() == b"machine code"


@pytest.mark.parametrize("error", [RuntimeError("Could not determine home directory."), None])
def test_without_a_home_nothing_was_compiled_before(monkeypatch: pytest.MonkeyPatch, error: Exception | None) -> None:
    def home() -> Path:
        if error:
            raise error
        return Path("/proc/1/fd")

    edition = compiled.edition()
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(compiled, "edition", lambda: edition)
    monkeypatch.setattr(compiled, "_HERE", Path("nowhere"))
    monkeypatch.setattr(compiled.Path, "home", home)
    assert not compiled.is_compiled()


def test_machine_code_is_of_its_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = tmp_path / "interpreter"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compiled, "_HERE", copy)
    assert compiled._sources() == compiled._LOADED
    with (copy / "lanes.py").open("a") as file:
        file.write("# another edition\n")
    assert compiled.edition.__wrapped__() == compiled.edition()  # of what this process has imported
    monkeypatch.setattr(compiled, "_LOADED", compiled._sources())
    assert compiled.edition.__wrapped__() != compiled.edition()


def test_numba_is_only_for_compiling() -> None:
    compiled.loops()  # so that they are kept
    code = (
        "import sys, gtau; from gtau.model.inverse_dynamics import InverseDynamics; "
        "InverseDynamics(gtau.load_robot('five-bar')).regressor([[0.1, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]]); "
        "print('numba' in sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": str(SOURCE.parents[2])}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert (found.stdout.strip(), found.stderr) == ("False", "")


def test_threads_that_come_first_together_link_once() -> None:
    """A second link would be freed while addresses of its code are in use."""
    program = (
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from threading import Barrier\n"
        "from gtau.model.interpreter.compiled import loops\n"
        "together = Barrier(8)\n"
        "def machine(_):\n"
        "    together.wait()\n"
        "    return loops().machine\n"
        "print(len(set(ThreadPoolExecutor(8).map(machine, range(8)))))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "1\n"
