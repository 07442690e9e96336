"""What an MJCF file may do to this machine, checked before it is read.

Bounds hold for the files that it opens, the elements that it repeats and the memory that it reserves. MuJoCo may still
crash, hang or exhaust the memory, so the file is first loaded in a separate process.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable
from itertools import product
from math import prod
from pathlib import Path
from xml.etree.ElementTree import Element

from gtau.documents.files import regular
from gtau.errors import GtauError
from gtau.robots.readers.xml_document import line_of, read_xml

MOST_FILES = 100  # hands and humanoids have fewer than ten
MOST_BODIES = 2000  # with copies: more keep the compiler busy for minutes
MOST_ELEMENTS = 20 * MOST_BODIES  # a body has about five
LARGEST_SIZE = 8192  # points along a side of a height field or texture: 256 MiB
COPYING = ("replicate", "composite", "flexcomp")
NESTED = ("worldbody", "body", "frame", "include", *COPYING)
SIZES = ("nrow", "ncol", "width", "height", "nkey")  # and nuser_...
FOLDERS = ("meshdir", "texturedir", "assetdir")

Files = dict[Path, Element]
PATIENCE = 60.0  # s; heavy meshes of public robots take five
MEMORY = 4 << 30  # bytes; the same need less than one
READER = """
import json, sys
sys.path[:], seconds, memory, kinds = json.loads(sys.argv[1])
import mujoco
try:
    import resource
except ImportError:  # Windows
    resource = None
def read(path):
    spec = mujoco.MjSpec.from_file(path)
    try:
        spec.compile()
    except ValueError:  # of a mesh that is missing: what is then compiled has none
        for kind in kinds:
            for part in list(getattr(spec, kind)):
                spec.delete(part)
        spec.compile()
if resource:
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
for line in sys.stdin:
    if resource:  # where nobody waits any more
        used = int(sum(resource.getrusage(resource.RUSAGE_SELF)[:2]))
        resource.setrlimit(resource.RLIMIT_CPU, (used + seconds, resource.getrlimit(resource.RLIMIT_CPU)[1]))
    said = ""
    try:
        read(json.loads(line))
    except (MemoryError, ValueError, RuntimeError, mujoco.FatalError) as error:
        said = "MemoryError" if isinstance(error, MemoryError) else str(error)
    print(json.dumps(said), flush=True)
"""
NO_MEMORY = ("MemoryError", "allocate memory", "unknown exception")  # as its C++ says

_lock = threading.Lock()
_readers: dict[int, subprocess.Popen[str]] = {}  # by process, as it may fork


def bounded(root: Element, path: Path) -> list[Element]:
    """List the outermost elements of a file and of those that it includes; refuse what is beyond the bounds."""
    files: Files = {path.resolve(): root}
    attached: Files = {}
    _collect(root, path, files, "include")
    for file, outermost in files.items():
        _collect(outermost, path if file == path.resolve() else file, attached, "model")
    if path.resolve() in attached:
        raise GtauError("it attaches itself by a <model>, without end; attach another file.")
    every = [*files.values(), *(one for file, one in attached.items() if file not in files)]
    elements = [element for outermost in every for element in outermost.iter()]
    _refuse_devices(elements, path)
    _check_sizes(elements)
    try:
        _check_copies(root, path, files)
        for file, outermost in attached.items():
            _check_copies(outermost, file, attached)
    except RecursionError:
        raise GtauError("its files are nested too deep; write them flatter.") from None
    return list(files.values())


def _collect(root: Element, path: Path, files: Files, tag: str) -> None:
    """Add the files that an element includes or attaches, and those that these do in turn, as MuJoCo finds them."""
    waiting = [root]
    while waiting:
        for element in waiting.pop().iter(tag):
            other = path.parent / element.get("file", "")
            if not other.is_file() or other.resolve() in files:
                continue
            if len(files) > MOST_FILES:
                raise GtauError(f"it reads more than {MOST_FILES} other files; give the file of the robot alone.")
            files[other.resolve()] = read_xml(other)
            waiting.append(files[other.resolve()])


def _refuse_devices(elements: Iterable[Element], path: Path) -> None:
    """Refuse pipes and devices, of which MuJoCo would read without end."""
    folders = {element.get(key, "") for element in elements if element.tag == "compiler" for key in FOLDERS}
    named = [element for element in elements if element.get("file")]
    for element, folder in product(named, {"", *folders}):
        try:
            regular(path.parent / folder / element.get("file", ""))
        except OSError as error:
            raise GtauError(
                f"line {line_of(element)}: <{element.tag}> cannot be read from '{element.get('file')}': "
                f"{error.strerror or error}; give a file."
            ) from None


def _check_sizes(elements: Iterable[Element]) -> None:
    for element in elements:
        for key, text in element.items():
            if (key in SIZES or key.startswith("nuser_")) and text.isdecimal() and int(text[:9]) > LARGEST_SIZE:
                raise GtauError(
                    f"line {line_of(element)}: {key} of <{element.tag}> is {text[:20]}, and at most {LARGEST_SIZE} is "
                    "read; give the file of the robot alone."
                )


def _check_copies(root: Element, path: Path, files: Files) -> None:
    """Refuse files that ask for more copies of a body, or of what it holds, than a robot can have."""

    def copies(element: Element, whole: bool) -> float:
        if element.tag == "include":  # twice, MuJoCo refuses
            element = once.pop((path.parent / element.get("file", "")).resolve(), element)
        inside = sum(copies(child, whole) for child in element if whole or child.tag in NESTED)
        if element.tag not in COPYING:
            return max(1.0, inside) + whole * (inside > 0)
        try:
            repeated = prod(float(word) for word in element.get("count", "1").split())
        except ValueError:
            return 0.0  # MuJoCo reports the error
        return repeated * max(1.0, inside)

    for elements, limit, what in ((False, MOST_BODIES, "bodies"), (True, MOST_ELEMENTS, "elements")):
        once = dict(files)
        if (most := copies(root, elements)) > limit:
            raise GtauError(
                f"it holds {most:.0f} {what}, with the copies that <replicate> and <composite> ask for, and at most "
                f"{limit} are read; give the file of the robot alone."
            )


def refuse_deadly(path: Path, without: tuple[str, ...] = (), patience: float = PATIENCE) -> None:
    """Refuse a file on which MuJoCo crashes, also ``without`` some elements, or needs too much time or memory."""
    with _lock:
        reader = _reader(without)
        timer = threading.Timer(patience, reader.kill)
        timer.start()
        try:
            assert reader.stdin is not None
            assert reader.stdout is not None
            reader.stdin.write(json.dumps(str(path.absolute())) + "\n")
            reader.stdin.flush()
            answer = reader.stdout.readline()
        except BrokenPipeError:
            answer = ""
        except BaseException:
            reader.kill()
            raise
        finally:
            late = not timer.is_alive()
            timer.cancel()
        if not answer:
            code = reader.wait()
    advice = "reduce it to the robot alone, without what it attaches or repeats"
    if not answer and (late or -code == getattr(signal, "SIGXCPU", None)):
        raise GtauError(f"MuJoCo works on the file for more than {patience:.0f} s; {advice}.")
    if not answer:
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise GtauError(f"MuJoCo crashes on the file ({name}); {advice}.")
    if any(words in answer for words in NO_MEMORY):
        raise GtauError(f"MuJoCo needs more than {MEMORY >> 30} GiB of memory for the file; {advice}.")


def _reader(without: tuple[str, ...]) -> subprocess.Popen[str]:
    """Return the process that reads files for this one; start it if it is missing or has died."""
    reader = _readers.get(os.getpid())
    if reader is None or reader.poll() is not None:
        options = json.dumps([sys.path, int(PATIENCE), MEMORY, without])
        few = {"MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1"}  # threads reserve memory
        reader = _readers[os.getpid()] = subprocess.Popen(
            [sys.executable, "-ISc", READER, options], env=os.environ | few, text=True, start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        atexit.register(reader.kill)
    return reader
