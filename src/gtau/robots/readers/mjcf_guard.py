"""Load an MJCF file in a process of its own first, because MuJoCo may crash, hang or run out of memory."""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from xml.etree.ElementTree import Element

from gtau.errors import GtauError
from gtau.robots.readers.xml_document import read_xml

MOST_FILES = 100  # hands and humanoids have fewer than ten
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


def included(root: Element, path: Path) -> list[Element]:
    """List the outermost elements of a file and of those that it includes, as MuJoCo finds them."""
    files = {path.resolve(): root}
    waiting = [root]
    while waiting:
        for element in waiting.pop().iter("include"):
            other = path.parent / element.get("file", "")
            if not other.is_file() or other.resolve() in files:
                continue
            if len(files) > MOST_FILES:
                raise GtauError(f"it reads more than {MOST_FILES} other files; give the file of the robot alone.")
            files[other.resolve()] = read_xml(other)
            waiting.append(files[other.resolve()])
    return list(files.values())


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
