"""Function files for MATLAB and GNU Octave, from the same expressions as the C code."""

from __future__ import annotations

import re
from pathlib import Path

import casadi as ca

from gtau.estimation.results.result import IdentifiedModel
from gtau.export.exported import Export, Exported, written
from gtau.export.generated import fields_of, filled
from gtau.uses.identified import OUTPUTS, Identified, identified, notes_on

ARGUMENTS = {"gravity": "c, p", "inertia": "c, p"}  # of the others: c, qd, qdd, p


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write a function file for each function, and ``NAME_parameters.m``, into ``out``."""
    model = identified(result)
    return Exported(written(out, matlab_files(model)), notes=notes_on(model))


def matlab_files(model: Identified) -> dict[str, str]:
    """Generate the function files: texts by file name."""
    fields = fields_of(model)
    made, files = fields["made"], {}
    for kind, description in OUTPUTS.items():
        arguments, kernel = ARGUMENTS.get(kind, "c, qd, qdd, p"), _kernel(made.outputs[kind], "kernel")
        more = {"kind": kind, "arguments": arguments, "description": description, "kernels": kernel}
        files[f"{model.name}_{kind}.m"] = filled("function.m", fields | more)
    steps = {"newton": made.step, "last_newton": made.last_step}
    fields["kernels"] = "".join(_kernel(step, name) for name, step in steps.items() if step is not None)
    for kind in ("currents", "move", "start", "rest", "parameters"):
        files[f"{model.name}_{kind}.m"] = filled(f"{kind}.m", fields)
    return files


def _kernel(function: ca.Function, name: str) -> str:
    """Generate CasADi's MATLAB code of a function, in which zeros among its inputs are constants."""
    text = function.export_code("matlab").split("function y=nonzeros_gen")[0]
    text = re.sub(r"nonzeros_gen\((varargin\{\d+\})\)", r"\1(:)", text)
    text = re.sub(r"\bf(max|min)\(", r"\1(", text)
    return re.sub(r"= \w+\(varargin\)", f"= {name}(varargin)", text, count=1).rstrip() + "\n"


EXPORTS = {"matlab": Export(export)}
