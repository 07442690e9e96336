"""Guard before MuJoCo, which may crash, hang or exhaust the memory: a file is first loaded in a separate process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree.ElementTree import Element

from gtau.errors import GtauError
from gtau.robots.readers.xml_document import read_xml

MOST_FILES = 100  # hands and humanoids have fewer than ten
PATIENCE = 60.0  # s; heavy meshes of public robots take five
MEMORY = 4 << 30  # bytes; the same need less than one
READER = """
import json, sys
sys.path[:], path, kinds, memory = json.loads(sys.argv[1])
import mujoco
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (600, 600))  # s, where nobody waits any more
except ImportError:  # Windows
    pass
spec = mujoco.MjSpec.from_file(path)
try:
    spec.compile()
except ValueError:  # of a mesh that is missing: what is then compiled has none
    for kind in kinds:
        for part in list(getattr(spec, kind)):
            spec.delete(part)
    spec.compile()
"""
NO_MEMORY = ("MemoryError", "allocate memory", "unknown exception")  # as its C++ says
FEW_THREADS = {"MALLOC_ARENA_MAX": "2", "OPENBLAS_NUM_THREADS": "1"}  # as threads reserve memory


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
    advice = "reduce it to the robot alone, without what it attaches or repeats"
    command = [sys.executable, "-ISc", READER, json.dumps([sys.path, str(path.absolute()), without, MEMORY])]
    environment = os.environ | FEW_THREADS
    try:
        reader = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=patience, check=False)
    except subprocess.TimeoutExpired:
        raise GtauError(f"MuJoCo works on the file for more than {patience:.0f} s; {advice}.") from None
    code, said = reader.returncode, reader.stderr
    if any(words in said for words in NO_MEMORY):
        raise GtauError(f"MuJoCo needs more than {MEMORY >> 30} GiB of memory for the file; {advice}.")
    if code not in (0, 1):  # 1 where Python said why, as MuJoCo will again
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise GtauError(f"MuJoCo crashes on the file ({name}); {advice}.")
