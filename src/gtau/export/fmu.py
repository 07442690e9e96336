"""A co-simulation FMU 3: positions, velocities and accelerations in, torques and currents out.

It is built by PythonFMU3 around the CasADi functions of the model, so the Python of the simulator needs casadi.
"""

from __future__ import annotations

import json
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory

from gtau.documents.files import suffixes
from gtau.errors import missing_extra
from gtau.estimation.results.result import Result
from gtau.export.c import CLOSED, NEWTON_STEPS, STARTING_STEPS, TEMPLATES
from gtau.export.exported import Export, Exported, written
from gtau.model.loop_paths import CONTRACTION
from gtau.model.loops import CONDITION
from gtau.uses.identified import Functions, Identified, functions, identified, notes_on

NEEDS = "the simulator's Python needs the packages casadi and numpy ('pythonfmu3 deploy' installs them)"


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME.fmu`` into ``out``.

    Raises
    ------
    GtauError
        Where PythonFMU3 is not installed.
    """
    try:
        from pythonfmu3.builder import FmuBuilder
    except ImportError:
        raise missing_extra("an export to FMU", "pythonfmu3", "fmu") from None
    model = identified(result)
    made = functions(model)
    with TemporaryDirectory() as name:
        folder = Path(name)
        script = folder / f"{model.name}.py"
        fields = {"name": model.name, "title": f"Inverse dynamics of {json.dumps(result.robot.name)[1:-1]}"}
        fields["friction"] = json.dumps(result.friction_law.range_sentence)[1:-1]
        script.write_text(Template((TEMPLATES / "slave.py.in").read_text(encoding="utf-8")).substitute(fields))
        resources = [folder / "model.json", folder / "requirements.txt"]
        resources[0].write_text(json.dumps(_document(model, made)))
        resources[1].write_text("casadi\nnumpy\n")
        for function in filter(None, (made.outputs["torques"], made.step, made.last_step)):
            resources.append(folder / f"{function.name()}.casadi")
            resources[-1].write_text(function.serialize())
        built = FmuBuilder.build_FMU(script, dest=folder / "built", project_files=resources)
        files = written(out, {f"{model.name}.fmu": Path(built).read_bytes()})
    return Exported(files, (NEEDS, *notes_on(model)))


def _document(model: Identified, made: Functions) -> dict[str, object]:
    robot, ends = model.result.robot, suffixes(model.joints)
    return {
        "joints": [
            {
                "name": joint,
                "identifier": ends[joint],
                "position_unit": robot.joint(joint).unit,
                "torque_unit": unit,
                "current_unit": "A" if model.result.kind == "current" else unit,
            }
            for joint, unit in zip(model.joints, model.units, strict=True)
        ],
        "p": model.values.tolist(),
        "payloads": {name: values.tolist() for name, values in model.payloads.items()},
        "drive_gains": model.gains.tolist(),
        "actuated": made.actuated.tolist(),
        "presliding": [[width, list(map(list, ratios.items()))] for width, ratios in made.presliding],
        "home": made.home.tolist(),
        "home_q": made.home[made.actuated].tolist(),
        "newton_steps": NEWTON_STEPS,
        "starting_steps": STARTING_STEPS,
        "closed": CLOSED,
        "contraction": CONTRACTION,
        "condition": CONDITION,
    }


EXPORTS = {"fmu": Export(export)}
