"""Generated code for one sample: C99, function files for MATLAB and GNU Octave, a co-simulation FMU 3.

All are made of the CasADi functions of the model, by templates of Jinja in which ``${...}`` is an expression and
``<% ... %>`` a statement. The C code allocates nothing. The FMU is built by PythonFMU3 around the serialized functions,
so the Python of the simulator needs casadi.
"""

from __future__ import annotations

import json
import re
import sys
import textwrap
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from keyword import iskeyword
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from gtau.documents.files import suffixes
from gtau.errors import needing
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.exported import Export, Exported, written
from gtau.model.loops import CONDITION, CONTRACTION
from gtau.uses.identified import OUTPUTS, Identified, functions, identified, notes_on

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).with_name("templates")
LINE = 116  # characters
# numbers of the closing of loops
CLOSING = {
    "newton_steps": 4,  # from 0.01 rad away corrections are about 1e-2, 1e-4, 1e-8, 1e-16: the fourth is rounding
    "starting_steps": 200,  # from home: a few milliradians or millimetres each
    "closed": 1e-8,  # of the last correction; the remaining error is its square
    "contraction": CONTRACTION,
    "condition": CONDITION,
}
BANDWIDTH = 100.0  # of the controller of the example, rad/s
# example.c, kernel_torques(), the headers of the C library and those that they include, and targets of CMake and make
TAKEN_IN_C = re.compile(
    "example|kernel|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|"
    "stdarg|stdbool|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype|"
    "alloca|availability|corecrt\\w*|crtdefs|endian|features|malloc|memory|pthread|runetype|sal|sched|strings|unistd|"
    "vadefs|vcruntime|xlocale|all|all_build|clean|depend|edit_cache|help|install\\w*|list_install_components|package\\w*|"
    "preinstall|rebuild_cache|run_tests|test|zero_check"
)
HELPER = re.compile(r"^casadi_real casadi_\w+\([^)]*\) *\{.*?\}$", re.MULTILINE | re.DOTALL)
BODY = re.compile(r"^static int casadi_f\d+\([^)]*\) *\{\n(.*?)^ *return 0;\n\}", re.MULTILINE | re.DOTALL)
IMPORTED_BY_FMU = ("casadi", "numpy", "pythonfmu3")
NEEDED_BY_FMU = "the simulator's Python needs the packages casadi and numpy ('pythonfmu3 deploy' installs them)"


def export_c(result: IdentifiedModel, out: Path) -> Exported:
    """Write C sources, header, controller, observer, example and CMake file of the identified model into ``out``."""
    model = identified(result)
    return Exported(written(out, c_files(model)), notes_on(model))


def c_files(model: Identified) -> dict[str, str]:
    """Generate the C sources, header, example and CMake file: texts by file name."""
    if TAKEN_IN_C.fullmatch(model.name):
        model = replace(model, name=f"robot_{model.name}")
    fields = _fields(model) | _fields_of_c(model)
    made, helpers, bodies = fields["made"], dict[str, None](), []
    for function in filter(None, (made.step, made.last_step)):
        outputs = ("moved", "size", "condition")[: function.n_out()]
        bodies.append(_c_kernel(function, ("c",), outputs, helpers))
    bodies += [_c_kernel(function, ("c", "qd", "qdd", "p"), ("out",), helpers) for function in made.outputs.values()]
    fields["kernels"] = "\n\n".join([*helpers, *bodies, ""])
    parts = {"model": "", "controller": "_controller", "observer": "_observer"}
    files = {f"{model.name}{end}.{kind}": f"{part}.{kind}" for part, end in parts.items() for kind in "hc"}
    files |= {name: name for name in ("example.c", "CMakeLists.txt")}
    return {name: _filled(template, fields) for name, template in files.items()}


def export_matlab(result: IdentifiedModel, out: Path) -> Exported:
    """Write a function file for each function, and ``NAME_parameters.m``, into ``out``."""
    model = identified(result)
    return Exported(written(out, matlab_files(model)), notes_on(model))


def matlab_files(model: Identified) -> dict[str, str]:
    """Generate the function files: texts by file name."""
    fields, files = _fields(model), {}
    made = fields["made"]
    for kind, description in OUTPUTS.items():
        fields["kind"], fields["description"] = kind, description
        fields["arguments"] = "c, p" if kind in ("gravity", "inertia") else "c, qd, qdd, p"
        fields["kernels"] = _matlab_kernel(made.outputs[kind], "kernel")
        files[f"{model.name}_{kind}.m"] = _filled("function.m", fields)
    steps = {"newton": made.step, "last_newton": made.last_step}
    fields["kernels"] = "".join(_matlab_kernel(step, name) for name, step in steps.items() if step is not None)
    for kind in ("currents", "move", "start", "rest", "parameters"):
        files[f"{model.name}_{kind}.m"] = _filled(f"{kind}.m", fields)
    return files


def export_fmu(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.fmu`` into ``out``; raises GtauError if PythonFMU3 is not installed."""
    with needing("an export to FMU", "pythonfmu3", "fmu"):
        from pythonfmu3.builder import FmuBuilder
    model = identified(result)
    if iskeyword(model.name) or model.name in sys.stdlib_module_names or model.name in IMPORTED_BY_FMU:
        model = replace(model, name=f"robot_{model.name}")
    fields = _fields(model)
    made = fields["made"]
    with TemporaryDirectory() as name:
        folder = Path(name)
        script = folder / f"{model.name}.py"
        texts = {"robot": result.robot.name, "friction": result.friction_law.range_sentence}
        # no pairs of surrogates, which are not characters in Python
        quoted = {key: json.dumps(text, ensure_ascii=False)[1:-1] for key, text in texts.items()}
        script.write_text(_filled("slave.py", fields | quoted), encoding="utf-8")
        resources = {"model.json": json.dumps(_document(fields)), "requirements.txt": "casadi\nnumpy\n"}
        for function in filter(None, (made.outputs["torques"], made.step, made.last_step)):
            resources[f"{function.name()}.casadi"] = function.serialize()
        for file, text in resources.items():
            (folder / file).write_text(text)
        files = [folder / file for file in resources]
        built = FmuBuilder.build_FMU(script, dest=folder / "built", project_files=files)
        fmu = {f"{model.name}.fmu": Path(built).read_bytes()}
        return Exported(written(out, fmu), (NEEDED_BY_FMU, *notes_on(model)))


def _fields(model: Identified) -> dict[str, Any]:
    """Collect the fields of all templates: the model, its CasADi functions (``made``), and values of both."""
    made, result = functions(model), model.result
    count = len(made.home) - len(made.presliding)
    return {
        **CLOSING,
        "model": model,
        "made": made,
        "result": result,
        "name": model.name,
        "NAME": model.name.upper(),
        "joints": [result.robot.joint(joint) for joint in model.joints],
        "current_unit": "A" if result.kind == "current" else "",
        "coordinates": count,
        "presliding": [(place, *state) for place, state in enumerate(made.presliding, start=count)],
        "payloads": list(zip(suffixes(model.payloads).values(), model.payloads.items(), strict=True)),
        "friction": " ".join(result.friction_law.range_sentence.split()),
    }


def _fields_of_c(model: Identified) -> dict[str, Any]:
    robot, loops = model.result.robot, model.result.idm.loops
    joints = [robot.joint(joint) for joint in model.joints]
    velocities = np.array([joint.limits.velocity or 10.0 for joint in joints])
    efforts = np.array([joint.limits.effort or 0.0 for joint in joints])
    length = 1.0 if loops is None else loops.layout.length
    motors = {str(name): estimate.value for name, estimate in model.result.motors.items()}
    return {
        "electrical": {kind: [motors.get(f"{kind}_{joint}", 0.0) for joint in model.joints] for kind in ("R", "ke")},
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


def _c_kernel(
    function: ca.Function, inputs: tuple[str, ...], outputs: tuple[str, ...], helpers: dict[str, None]
) -> str:
    """Generate CasADi's C code of a function, with its arguments called by their names; add to its ``helpers``."""
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


def _matlab_kernel(function: ca.Function, name: str) -> str:
    """Generate CasADi's MATLAB code of a function, in which zeros among its inputs are constants."""
    text = function.export_code("matlab").split("function y=nonzeros_gen")[0]
    text = re.sub(r"nonzeros_gen\((varargin\{\d+\})\)", r"\1(:)", text)
    text = re.sub(r"\bf(max|min)\(", r"\1(", text)
    return re.sub(r"= \w+\(varargin\)", f"= {name}(varargin)", text, count=1).rstrip() + "\n"


def _document(fields: dict[str, Any]) -> dict[str, object]:
    model, made = fields["model"], fields["made"]
    ends = suffixes(model.joints)
    joints = [
        {
            "name": joint.name,
            "identifier": ends[joint.name],
            "position_unit": joint.unit,
            "torque_unit": unit,
            "current_unit": fields["current_unit"] or unit,
        }
        for joint, unit in zip(fields["joints"], model.units, strict=True)
    ]
    return CLOSING | {
        "joints": joints,
        "p": model.values.tolist(),
        "payloads": {name: values.tolist() for name, values in model.payloads.items()},
        "drive_gains": model.gains.tolist(),
        "actuated": made.actuated.tolist(),
        "presliding": [[width, list(map(list, ratios.items()))] for _, width, ratios in fields["presliding"]],
        "home": made.home.tolist(),
        "home_q": made.home[made.actuated].tolist(),
    }


def _filled(template: str, fields: dict[str, Any]) -> str:
    return _environment().get_template(f"{template}.in").render(fields)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    made = Environment(  # of code, which needs no escapes of HTML
        variable_start_string="${",
        variable_end_string="}",
        block_start_string="<%",
        block_end_string="%>",
        comment_start_string="<#",
        comment_end_string="#>",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        loader=FileSystemLoader(TEMPLATES),
    )
    made.filters |= {"numbers": _numbers, "wrapped": wrapped, "in_c": in_c, "in_matlab": in_matlab}
    return made


def _numbers(values: Iterable[float | None], between: str = ", ") -> str:
    return between.join("NaN" if value is None else repr(float(value)) for value in values)


def wrapped(text: str, indent: str) -> str:
    """Break a text into lines that begin with ``indent``."""
    return textwrap.fill(text, LINE, initial_indent=indent, subsequent_indent=indent)


def in_c(text: str) -> str:
    """Clean a text so that it is safe in a comment and in a string of C."""
    return re.sub(r"[^\w .,:;()+/-]", "_", text, flags=re.ASCII)


def in_matlab(text: str) -> str:
    """Write a text as a string of MATLAB."""
    return "'" + "".join(c if c.isprintable() else " " for c in text).replace("'", "''") + "'"


EXPORTS = {"c": Export(export_c), "matlab": Export(export_matlab), "fmu": Export(export_fmu)}
