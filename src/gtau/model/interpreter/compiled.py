"""Machine code of the compiled loops: compiled once per machine by Numba, cached on disk, and linked by LLVM.

Numba takes half a second to import, so it is imported only to compile. The file's name has a digest of all that the
code depends on: the sources, the versions of Numba and of the code generator, and the processor. A file that is lost,
damaged or cannot be written costs compiling again.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

from gtau.documents.files import write_atomically
from gtau.errors import GtauError

_HERE = Path(__file__).parent
_ARGUMENTS = {"run_machine": 3, "interpret": 10, "scatter": 16, "advance_to": 7, "follow_path": 8}
_DIGEST = 32  # bytes that the file begins with: of the machine code after them


def _sources() -> bytes:
    return b"".join(path.read_bytes() for path in sorted(_HERE.glob("*.py")))


_LINKING = Lock()
_LOADED = _sources()  # as imported: files that are replaced later, by an update, are of other machine code


class CompiledLoops(NamedTuple):
    """The address of the interpreter of one lane, and functions of addresses and whole numbers, of ``kernel.py``.

    The code stays in memory for as long as ``linked`` does.
    """

    linked: Any
    machine: int
    interpret: Callable[..., None]
    scatter: Callable[..., None]
    advance_to: Callable[..., None]
    follow_path: Callable[..., None]


def loops() -> CompiledLoops:
    """Return the functions of the machine code, linked once a process; they release Python's lock while they run."""
    with _LINKING:  # a second link of two threads would be freed while its addresses are in use
        return _linked()


@cache
def _linked() -> CompiledLoops:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = llvm.JITLibraryBuilder().add_object_img(_kept() or _made()).add_current_process()
    for name in _ARGUMENTS:
        library.export_symbol(name)
    linker = llvm.create_lljit_compiler(_processor())
    linked = library.link(linker, "gtau")
    kinds = {name: ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * count) for name, count in _ARGUMENTS.items()}
    functions = {name: kinds[name](linked[name]) for name in _ARGUMENTS if name != "run_machine"}
    return CompiledLoops((linker, linked), linked["run_machine"], **functions)


def is_compiled() -> bool:
    """Return whether the loops have been compiled on this machine before, without importing Numba."""
    return _kept() is not None


@cache
def edition() -> str:
    """Return the digest of the sources, versions and processor that the machine code depends on."""
    import llvmlite.binding as llvm

    features = sorted(llvm.get_host_cpu_features().items())
    made_by = f"{version('numba')} {version('llvmlite')} {llvm.get_host_cpu_name()} {features}"
    return sha256(_LOADED + made_by.encode()).hexdigest()[:16]


def _places() -> Iterator[Path]:
    """Yield the candidate locations of the file: beside the bytecode, or the user's cache if that is not writable."""
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    if elsewhere:
        yield Path(elsewhere)
        return
    yield _HERE / "__pycache__"
    try:
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gtau"
    except RuntimeError:  # there is no home
        return


def _kept() -> bytes | None:
    """Return the cached machine code, or None if it is missing or damaged."""
    for folder in _places():
        try:
            content = (folder / f"loops-{edition()}.o").read_bytes()
        except OSError:
            continue
        if sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
            return content[_DIGEST:]
    return None


def _made() -> bytes:
    """Compile the loops, cache the machine code on disk, and return it."""
    import llvmlite.binding as llvm
    from numba import cfunc, types

    from gtau.model.interpreter import kernel

    # what Numba frees arrays with: nothing is allocated, but the compiler does not see that everywhere
    library = llvm.parse_assembly("define void @NRT_MemInfo_call_dtor(ptr %0) {\n  ret void\n}\n")
    for name, count in _ARGUMENTS.items():
        signature = types.void(*[types.int64] * count)
        function = cfunc(signature, error_model="numpy")(getattr(kernel, name))
        module = llvm.parse_assembly(function.inspect_llvm())
        # Numba's entry for C reports errors by Python, which none of these functions raises: a bare one replaces it
        module.link_in(llvm.parse_assembly(_entry(name, function.native_name.removeprefix("cfunc."), count)))
        library.link_in(module)
    for symbol in (*library.functions, *library.global_variables):
        if not symbol.is_declaration and symbol.name not in _ARGUMENTS:
            symbol.linkage = "internal"
    processor = _processor()
    builder = llvm.create_pass_builder(processor, llvm.create_pipeline_tuning_options(speed_level=0))
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(library, builder)
    code: bytes = processor.emit_object(library)
    if _sources() == _LOADED:
        _keep(code)
    return code


def _keep(code: bytes) -> None:
    """Write the machine code into the first folder that can be written to, or nowhere."""
    for folder in _places():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / f"loops-{edition()}.o", sha256(code).digest() + code)
        except (OSError, GtauError):
            continue
        return


def _entry(name: str, within: str, count: int) -> str:
    """Return LLVM's assembly of a function that calls one of Numba's, which returns a status that is always 0."""
    kinds, values = ", ".join(["i64"] * count), ", ".join(f"i64 %{k}" for k in range(count))
    return (
        f'declare i32 @"{within}"(ptr, ptr, {kinds})\n'
        f"define void @{name}({kinds}) {{\n"
        f"  %nothing = alloca ptr\n"
        f'  %status = call i32 @"{within}"(ptr %nothing, ptr %nothing, {values})\n'
        "  ret void\n}\n"
    )


def _processor() -> Any:
    """Return LLVM's machine for this processor."""
    import llvmlite.binding as llvm

    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3, reloc="pic"
    )
