"""Compiled functions where nothing can be cached."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gtau.model.interpreter import compiled
from gtau.model.interpreter.compiled import _cached


def test_without_a_folder_for_a_cache_functions_are_compiled_all_the_same() -> None:
    def decorator(cache: bool) -> Callable[[str], str]:
        if cache:
            raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")
        return str.upper

    assert _cached(decorator, "f") == "F"  # type: ignore[arg-type]

    def broken(cache: bool) -> None:
        raise RuntimeError("no compiler")

    with pytest.raises(RuntimeError, match="no compiler"):
        _cached(broken, str.upper)


@pytest.mark.parametrize("error", [RuntimeError("Could not determine home directory."), PermissionError()])
def test_without_a_home_nothing_was_compiled_before(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def refused(*given: object) -> Path:
        raise error

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(compiled, "_HERE", Path("nowhere"))
    monkeypatch.setattr(compiled.Path, "home" if isinstance(error, RuntimeError) else "rglob", refused)
    assert not compiled.is_compiled()
