"""A co-simulation FMU 3: positions, velocities and accelerations in, torques and currents out.

It is built by PythonFMU3 around the CasADi functions of the model, so the Python of the simulator needs casadi.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from keyword import iskeyword
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gtau.documents.files import suffixes
from gtau.errors import missing_extra
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.exported import Export, Exported, written
from gtau.export.generated import CLOSING, fields_of, filled
from gtau.uses.identified import identified, notes_on

IMPORTED = ("casadi", "numpy", "pythonfmu3")
NEEDS = "the simulator's Python needs the packages casadi and numpy ('pythonfmu3 deploy' installs them)"


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.fmu`` into ``out``; raises GtauError if PythonFMU3 is not installed."""
    try:
        from pythonfmu3.builder import FmuBuilder
    except ImportError:
        raise missing_extra("an export to FMU", "pythonfmu3", "fmu") from None
    model = identified(result)
    if iskeyword(model.name) or model.name in sys.stdlib_module_names or model.name in IMPORTED:
        model = replace(model, name=f"robot_{model.name}")
    fields = fields_of(model)
    with TemporaryDirectory() as name:
        folder = Path(name)
        script = folder / f"{model.name}.py"
        texts = {"robot": result.robot.name, "friction": result.friction_law.range_sentence}
        # no pairs of surrogates, which are not characters in Python
        quoted = {key: json.dumps(text, ensure_ascii=False)[1:-1] for key, text in texts.items()}
        script.write_text(filled("slave.py", fields | quoted), encoding="utf-8")
        resources = [folder / "model.json", folder / "requirements.txt"]
        resources[0].write_text(json.dumps(_document(fields)))
        resources[1].write_text("casadi\nnumpy\n")
        made = fields["made"]
        for function in filter(None, (made.outputs["torques"], made.step, made.last_step)):
            resources.append(folder / f"{function.name()}.casadi")
            resources[-1].write_text(function.serialize())
        built = FmuBuilder.build_FMU(script, dest=folder / "built", project_files=resources)
        files = written(out, {f"{model.name}.fmu": Path(built).read_bytes()})
    return Exported(files, (NEEDS, *notes_on(model)))


def _document(fields: dict[str, Any]) -> dict[str, object]:
    model, made, ends = fields["model"], fields["made"], suffixes(fields["model"].joints)
    return CLOSING | {
        "joints": [
            {
                "name": joint.name,
                "identifier": ends[joint.name],
                "position_unit": joint.unit,
                "torque_unit": unit,
                "current_unit": fields["current_unit"] or unit,
            }
            for joint, unit in zip(fields["joints"], model.units, strict=True)
        ],
        "p": model.values.tolist(),
        "payloads": {name: values.tolist() for name, values in model.payloads.items()},
        "drive_gains": model.gains.tolist(),
        "actuated": made.actuated.tolist(),
        "presliding": [[width, list(map(list, ratios.items()))] for _, width, ratios in fields["presliding"]],
        "home": made.home.tolist(),
        "home_q": made.home[made.actuated].tolist(),
    }


EXPORTS = {"fmu": Export(export)}
