"""C99: torques, currents, gravity, friction, inertia, regressor and momentum of a pose, without allocation."""

from __future__ import annotations

import re
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from gtau.estimation.results.result import IdentifiedModel
from gtau.export.exported import Export, Exported, written
from gtau.export.generated import fields_of, filled, in_c
from gtau.uses.identified import Functions, Identified, identified, notes_on

BANDWIDTH = 100.0  # of the controller of the example, rad/s
# example.c, kernel_torques(), the headers of the C library and those that they include, and targets of CMake and make
TAKEN = re.compile(
    "example|kernel|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|"
    "stdarg|stdbool|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype|"
    "alloca|availability|corecrt\\w*|crtdefs|endian|features|malloc|memory|pthread|runetype|sal|sched|strings|unistd|"
    "vadefs|vcruntime|xlocale|all|all_build|clean|depend|edit_cache|help|install\\w*|list_install_components|package\\w*|"
    "preinstall|rebuild_cache|run_tests|test|zero_check"
)
HELPER = re.compile(r"^casadi_real casadi_\w+\([^)]*\) *\{.*?\}$", re.MULTILINE | re.DOTALL)
BODY = re.compile(r"^static int casadi_f\d+\([^)]*\) *\{\n(.*?)^ *return 0;\n\}", re.MULTILINE | re.DOTALL)


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write C sources, header, controller, observer, example and CMake file of the identified model into ``out``."""
    model = identified(result)
    return Exported(written(out, c_files(model)), notes=notes_on(model))


def c_files(model: Identified) -> dict[str, str]:
    """Generate the C sources, header, example and CMake file: texts by file name."""
    if TAKEN.fullmatch(model.name):
        model = replace(model, name=f"robot_{model.name}")
    fields = fields_of(model) | _fields(model)
    fields["kernels"] = _kernels(fields["made"])
    parts = {"model": "", "controller": "_controller", "observer": "_observer"}
    files = {f"{model.name}{end}.{kind}": f"{part}.{kind}" for part, end in parts.items() for kind in "hc"}
    files |= {name: name for name in ("example.c", "CMakeLists.txt")}
    return {name: filled(template, fields) for name, template in files.items()}


def _fields(model: Identified) -> dict[str, Any]:
    robot, loops = model.result.robot, model.result.idm.loops
    joints = [robot.joint(joint) for joint in model.joints]
    velocities = np.array([joint.limits.velocity or 10.0 for joint in joints])
    efforts = np.array([joint.limits.effort or 0.0 for joint in joints])
    length = 1.0 if loops is None else loops.layout.length
    return {
        "robot": in_c(robot.name),
        "runs": in_c(textwrap.shorten(", ".join(model.result.runs), 60, placeholder=" ...")),
        "parameters": [(value, _comment(k, model)) for k, value in enumerate(model.values.tolist())],
        "length": length,
        "amplitude": ", ".join("0.02" if joint.turns else f"{0.02 * length:.4g}" for joint in joints),
        "limits": efforts / np.abs(model.gains),
        "limited": "the robot file's efforts over the drive gains" + (", 0 where it has none" * (0.0 in efforts)),
        "velocities": velocities,
        "following": 3.0 / BANDWIDTH * velocities,
        "bandwidth": BANDWIDTH,
        "csv_head": ",".join(["t", *(f"{kind}{in_c(joint)}" for kind in "vuc" for joint in model.joints)]),
    }


def _comment(k: int, model: Identified) -> str:
    estimate = model.parameters[k]
    std = "" if estimate.std is None else f", standard deviation {estimate.std:.2g}"
    regrouping = f" = {estimate.regroups}" if estimate.regroups else ""
    comment = textwrap.shorten(f"{k} {estimate.name}, {estimate.unit}{std}{regrouping}", 90, placeholder=" ...")
    return comment.replace("*/", "* /").replace("/*", "/ *")


def _kernels(made: Functions) -> str:
    """Generate all functions as C: CasADi's code of each, with its arguments called by their names."""
    helpers: dict[str, None] = {}
    bodies = []
    for function in filter(None, (made.step, made.last_step)):
        outputs = ("moved", "size", "condition")[: function.n_out()]
        bodies.append(_kernel(function, ("c",), outputs, helpers))
    for function in made.outputs.values():
        bodies.append(_kernel(function, ("c", "qd", "qdd", "p"), ("out",), helpers))
    return "\n\n".join([*helpers, *bodies, ""])


def _kernel(function: ca.Function, inputs: tuple[str, ...], outputs: tuple[str, ...], helpers: dict[str, None]) -> str:
    generator = ca.CodeGenerator("kernel.c", {"with_header": False, "include_math": False})
    generator.add(function)
    text = generator.dump()
    helpers |= {f"static {helper.group()}".replace("casadi_real", "double"): None for helper in HELPER.finditer(text)}
    match = BODY.search(text)
    assert match is not None, "CasADi writes its functions in another form than this version reads"
    body = match.group(1).replace("casadi_real", "double")
    body = re.sub(r"arg\[(\d+)\]\? *arg\[\1\]\[(\d+)\] *: *0", lambda m: f"{inputs[int(m[1])]}[{m[2]}]", body)
    body = re.sub(r"if \(res\[(\d+)\]!=0\) *res\[\1\]\[(\d+)\]", lambda m: f"{outputs[int(m[1])]}[{m[2]}]", body)
    assert not re.search(r"\b(arg|res)\[", body), "CasADi writes arguments in another form than this version reads"
    unused = [name for name in inputs if not re.search(rf"\b{name}\[", body)]
    arguments = [*(f"const double *{name}" for name in inputs), *(f"double *{name}" for name in outputs)]
    ignored = "".join(f"  (void)({name});\n" for name in unused)
    return f"static void kernel_{function.name()}({', '.join(arguments)}) {{\n{ignored}{body}}}"


EXPORTS = {"c": Export(export)}
