"""Compile the geometry of an MJCF file by MuJoCo, and check its numbers and angles.

A file is first loaded in another process, because MuJoCo may crash, hang or run out of memory.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import chain, count
from math import pi
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.documents.markup import LARGEST, all_numbers, decimals, line_of, read_xml
from gtau.documents.validation import some_of
from gtau.errors import GtauError, needing
from gtau.robots import placement
from gtau.robots.robot import Pose, refuse_many

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


try:
    import mujoco as mujoco
except ImportError:  # an extra
    mujoco = None

SHAPES = ("sensors", "geoms", "pairs", "excludes", "skins", "flexes", "meshes", "textures", "materials", "hfields")
DELETED = ("sensors", "actuators", "tendons", "keys", "cameras", "lights", *SHAPES[1:], "numerics", "texts", "tuples")
"""Elements without effect on geometry and, except for heavy shapes, on inertias: they need not even compile."""
WATER = 1000.0  # kg/m3: density of shapes in a file that states none

GEOMETRY = ("pos", "quat", "axis", "axisangle", "euler", "xyaxes", "zaxis", "anchor", "relpose", "ref", "springref")
FORCES = ("stiffness", "damping", "frictionloss", "armature", "springlength", "biasprm", "gainprm", "viscosity")
MASSES = ("mass", "diaginertia", "fullinertia")
RANGES = ("range", "ctrlrange", "forcerange", "actuatorfrcrange")
NUMBERS = (*GEOMETRY, *FORCES, *MASSES, "qpos", "gravity", "polycoef", "coef", "gear", *RANGES)


def _check_numbers(roots: Iterable[Element]) -> None:
    """Refuse implausible numbers, some of which MuJoCo accepts with or without a warning."""
    for element in (part for root in roots for part in root.iter() if part.tag != "flag"):
        for key in NUMBERS:
            text = element.get(key, "")
            if decimals(text, endless=key in RANGES) is None:
                raise GtauError(
                    f"line {line_of(element)}: {key} of <{element.tag}> is '{text[:80]}'; "
                    f"write plain decimal numbers, at most {LARGEST:g} in size."
                )


@dataclass(frozen=True)
class MjcfFile:
    """An MJCF file: its specification and the compiled model."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    notes: list[str]  # of changes and omissions before compilation
    has_masses: bool
    elements: list[Element]  # the outermost ones of the file and its includes


def _with_exact_orientations(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Replace rounded orientations in ``spec`` by the exact ones, with a note."""

    def exact(element: Any) -> float:
        kind, radian = element.alt.type, not spec.compiler.degree
        if kind == mujoco.mjtOrientation.mjORIENTATION_EULER and radian:
            given = np.array(element.alt.euler)
            element.alt.euler = angles = np.array([placement.exact_angle(angle) for angle in given])
            return placement.largest_change(given, angles)
        if kind == mujoco.mjtOrientation.mjORIENTATION_AXISANGLE and radian:
            given = np.array(element.alt.axisangle)
            element.alt.axisangle = meant = np.array([*given[:3], placement.exact_angle(given[3])])
            return placement.largest_change(given, meant)
        written = np.array(element.quat)
        unit = placement.smallest_unit(written)
        if kind != mujoco.mjtOrientation.mjORIENTATION_QUAT or unit > placement.MEANT:
            return 0.0
        rotation = rotation_in(written).as_matrix()
        roll, pitch, yaw = (round(angle / placement.STEP) * placement.STEP for angle in placement.angles_of(rotation))
        turned = Pose(rpy=(roll, pitch, yaw)).rotation
        meant = type(rotation_in(written)).from_matrix(turned).as_quat(scalar_first=True)
        meant *= np.copysign(1.0, meant @ written)
        if np.abs(written - meant).max() >= unit:
            return 0.0
        element.quat = meant
        return placement.largest_change([np.linalg.norm(rotation - turned) / np.sqrt(2)], [0.0])

    placed = (*spec.bodies[1:], *spec.frames, *spec.sites)
    return placement.short_angles_note(
        {element.name or f"unnamed {k}": exact(element) for k, element in enumerate(placed, start=1)}
    )


def _weighs(geom: mujoco.MjsGeom, spec: mujoco.MjSpec) -> bool:
    """Return whether a shape adds to the inertia of a moving body."""
    body, rule = geom.parent, mujoco.mjtInertiaFromGeom
    compiler = getattr(body, "compiler", spec.compiler)  # of its own since MuJoCo 4
    first, last = compiler.inertiagrouprange
    if compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_AUTO:
        counts = not body.explicitinertial
    else:
        counts = compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_TRUE
    heavy = geom.mass != 0 and (geom.mass > 0 or geom.density != 0) and first <= geom.group <= last
    while spec.compiler.settotalmass <= 0 and body is not None and not body.joints:
        body = body.parent
    return bool(heavy and counts and body is not None)


def _reduce(spec: mujoco.MjSpec, sites: Iterable[str], masses: bool) -> list[str]:
    """Delete elements without effect on geometry or ``masses``, but keep ``sites``; note inactive equalities."""
    notes = []
    for equality in list(spec.equalities):
        if not equality.active:
            notes.append(f"equality '{equality.name}' is not active in the file and was left out")
        if not equality.active or equality.type == mujoco.mjtEq.mjEQ_TENDON:
            spec.delete(equality)
    meshes = set[str]()
    for kind in DELETED:
        for element in list(getattr(spec, kind)):
            if kind == "geoms" and masses and _weighs(element, spec):
                meshes.add(element.meshname)
                element.material = ""
                element.contype = element.conaffinity = 0  # else meshes need a hull
            elif kind != "meshes" or element.name not in meshes:
                spec.delete(element)
    kept = {name for equality in spec.equalities for name in (equality.name1, equality.name2)}.union(sites)
    for site in list(spec.sites):
        if site.name in kept:
            site.material = ""
        else:
            spec.delete(site)
    for body in () if masses else spec.bodies[1:]:
        body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
        body.iquat, body.fullinertia[0] = (1.0, 0.0, 0.0, 0.0), np.nan
    return notes


def straight_tendons(spec: mujoco.MjSpec) -> dict[str, tuple[str, str]]:
    """Find the two sites of each tendon that runs straight from one to the other."""
    site, tendons = mujoco.mjtWrap.mjWRAP_SITE, {}
    for tendon in spec.tendons:
        path = list(tendon.path)
        if [point.type for point in path] == [site, site] and all(point.target for point in path):
            tendons[tendon.name] = (path[0].target.name, path[1].target.name)
    return tendons


def compile_mjcf(root: Element, path: Path) -> MjcfFile:
    """Compile the bodies, joints and equalities of an MJCF file whose outermost element is ``root``."""
    elements = included(root, path)
    _check_numbers(elements)
    with needing("reading an MJCF file", "mujoco", "mujoco"):
        import_module("mujoco")
    refusals = (ValueError, RuntimeError, mujoco.FatalError)
    refuse_deadly(path, DELETED)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        refuse_many(len(spec.bodies), "bodies")
        if len(spec.flexes):
            raise GtauError("it holds a flexible body (flex); only rigid bodies are read, so remove it.")
        names = {tendon.name for tendon in spec.tendons}
        free = (name for number in count(1) if (name := f"tendon {number}") not in names)
        for tendon in spec.tendons:
            tendon.name = tendon.name or next(free)
        sites = set(chain(*straight_tendons(spec).values()))
        unread = list[str]()
        states_masses = spec.compiler.settotalmass > 0 or any(body.explicitinertial for body in spec.bodies[1:])
        if states_masses or any(geom.mass > 0 or geom.density not in (0.0, WATER) for geom in spec.geoms):
            try:
                return MjcfFile(spec, *_compiled(path, sites, masses=True), elements)
            except refusals as error:
                unread.append(f"the masses in the file were not read, as MuJoCo does not compile them ({_said(error)})")
        elif spec.geoms:
            unread.append("the file states no masses, and masses of its shapes at the density of water were not read")
        model, notes, has_masses = _compiled(path, sites, masses=False)
        return MjcfFile(spec, model, [*notes, *unread], has_masses, elements)
    except GtauError:
        raise
    except refusals as error:
        raise GtauError(f"MuJoCo refuses the file ({_said(error)}); correct it.") from None


def _compiled(path: Path, sites: Iterable[str], masses: bool) -> tuple[mujoco.MjModel, list[str], bool]:
    """Read a file again (a copy would lack invalid equalities), reduce and compile it; return model, notes, masses."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic &= spec.compiler.settotalmass > 0
    notes = [*_with_exact_orientations(spec), *_reduce(spec, sites, masses)]
    with catch_warnings():
        simplefilter("ignore")  # deprecated attributes
        return spec.compile(), notes, masses


def _said(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")


def name_in(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element, or its kind and number where it has none."""
    element: Any = getattr(model, kind)(number)
    return element.name or f"{kind} {number + 1}"


def rotation_in(quaternion: np.ndarray) -> Rotation:
    """Make the rotation of a quaternion (4,), w first; zeros give the identity, as in MuJoCo's keyframes."""
    return Rotation.from_quat(quaternion, scalar_first=True) if np.any(quaternion) else Rotation.identity()


def pose_in(position: np.ndarray, quaternion: np.ndarray) -> Pose:
    """Make the pose of a position (3,) and a quaternion (4,), w first."""
    return placement.pose_of(rotation_in(quaternion).as_matrix(), position)


PLACED = ("body", "frame", "site", "joint", "connect", "weld")
ORIENTATIONS = ("quat", "axisangle", "axis", "xyaxes", "zaxis")


def mjcf_rounding(roots: list[Element]) -> placement.Digits:
    """Find the digits of the placements in a file."""
    placed = [element for root in roots for element in root.iter() if element.tag in PLACED]
    radian = any(compiler.get("angle") == "radian" for root in roots for compiler in root.iter("compiler"))
    angles = all_numbers(placed, ["euler"])
    unit = 1.0 if radian else pi / 180
    directions = placement.digits_of(all_numbers(placed, ORIENTATIONS) + angles * radian)
    # twice the change of a quaternion's four numbers is a turn
    turn = 4 * directions.half_unit(0.5) or 4 * unit * placement.digits_of(angles).half_unit(1 / unit)
    return replace(placement.digits_of(all_numbers(placed, ["pos", "anchor"])), turn=turn)


SHOWN = 4


def angle_notes(roots: list[Element]) -> Iterator[str]:
    """Note orientations and limits that are multiples of pi/4 in a file in degrees."""
    units = [compiler.get("angle") for root in roots for compiler in root.iter("compiler") if compiler.get("angle")]
    meant = []
    for element, what, angle in _angles(roots):
        if "radian" not in units:
            eighths = round(angle / (pi / 4))
            if 0 < abs(eighths) <= 8 and abs(angle - eighths * pi / 4) < placement.SHORT:
                meant.append(f"{what} (line {line_of(element)}: {angle:g})")
        elif element.tag != "joint" and placement.in_degrees(angle):
            raise GtauError(
                f"line {line_of(element)}: {what} holds {angle:g}, but the file counts in radians (angle of "
                "<compiler>); divide it by 57.2958 if it is in degrees."
            )
    if meant:
        yield (
            f"angles that look like radians, though the file counts in degrees (angle of <compiler>): "
            f"{some_of(meant, SHOWN)}; they were taken as degrees"
        )


def _angles(roots: Iterable[Element]) -> Iterator[tuple[Element, str, float]]:
    """Iterate over the angles of orientations and of hinge limits, with their element and a description."""
    for element in (part for tag in ("body", "frame", "joint") for root in roots for part in root.iter(tag)):
        name = f"{element.tag} '{element.get('name', element.get('class', ''))}'"
        key = "range" if element.tag == "joint" else "euler"
        if element.tag == "joint" and element.get("type", "hinge") != "hinge":
            continue
        if element.tag == "frame" and element.find(".//body") is None:
            continue  # of shapes
        for angle in decimals(element.get(key, "")) or ():
            yield element, f"{key} of {name}", angle
        if element.tag != "joint" and len(turn := decimals(element.get("axisangle", "")) or []) == 4:
            yield element, f"axisangle of {name}", turn[3]
