"""Function files for MATLAB and GNU Octave, from the same expressions as the C code."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from pathlib import Path

import casadi as ca
import numpy as np

from gtau.estimation.results.result import Result
from gtau.export.c import CLOSED, NEWTON_STEPS, STARTING_STEPS
from gtau.export.exported import Export, Exported, written
from gtau.model.loop_paths import CONTRACTION
from gtau.model.loops import CONDITION
from gtau.uses.identified import OUTPUTS, Functions, Identified, functions, identified, notes_on

ARGUMENTS = {"gravity": "c, p", "inertia": "c, p"}  # of the others: c, qd, qdd, p
MOVE = """\
function [c, status] = {name}_move(c, q)
% {NAME}_MOVE  Bring the configuration c from the last pose to the actuated positions q.
%   status 0: done; 1: the loops did not close from the last pose; 2: too close to a type 2 singularity; 3: a position
%   is infinite or not a number. After a status other than 0, c is the last good configuration. Begin with {name}_start.
  actuated = [{actuated}];
  before = c(:);
  moved = before(1:{n_c});
  moved(actuated) = q(:);
  first = 0;
  status = 3;
  if ~all(isfinite(q(:))), return; end
  status = 1;
  for step = 1:{steps}
    if step < {steps}
      [moved, size_] = newton(moved);
    else
      [moved, size_, condition] = last_newton(moved);
    end
    if step == 1, first = size_; end
    if step == 2 && ~(size_ <= {contraction} * first || size_ <= {closed}), return; end
  end
  if ~(size_ <= {closed}), return; end
  status = 2;
  if ~(condition < {condition}), return; end
  status = 0;
  c = preslide(before, moved);
end
"""
START = """\
function [c, status] = {name}_start(q)
% {NAME}_START  Bring the configuration from home to the actuated positions q in small steps.
  home = [{home}].';
  actuated = [{actuated}];
  c = home;
  for step = 1:{steps}
    [c, status] = {name}_move(c, home(actuated) + (q(:) - home(actuated)) * step / {steps});
    if status ~= 0, return; end
  end
end
"""
SERIAL_MOVE = """\
function [c, status] = {name}_move(c, q)
% {NAME}_MOVE  Configuration of the actuated positions q: they themselves, as the robot has no loops.
%   status 0: done; 3: a position is infinite or not a number, and c the last configuration.
  status = 3;
  if ~all(isfinite(q(:))), return; end
  c = preslide(c(:), q(:));
  status = 0;
end
"""
SERIAL_START = """\
function [c, status] = {name}_start(q)
% {NAME}_START  Configuration of the actuated positions q, home where one of them is no finite number.
  [c, status] = {name}_move([{home}].', q);
end
"""
REST = """\
function c = {name}_rest(c)
% {NAME}_REST  The robot rests at c: from here on {name}_move carries the state of friction before sliding.
%   Without it, Coulomb friction has the sign of the velocity given, whatever came before (for feed-forward).
  c({n_c} + 1:end) = 0;
end
"""
PRESLIDE = """\
function c = preslide(before, moved)
% Friction before sliding: the way since the last pose moves its states, which stand behind the configuration. A state
% beyond 1 stays: that joint slides.
  c = [moved; before(numel(moved) + 1:end)];
{lines}end
"""


def export(result: Result, out: Path) -> Exported:
    """Write a function file for each function, and ``NAME_parameters.m``, into ``out``."""
    model = identified(result)
    return Exported(written(out, matlab_files(model)), notes=notes_on(model))


def matlab_files(model: Identified) -> dict[str, str]:
    """Generate the function files: texts by file name."""
    made, name = functions(model), model.name
    files = {f"{name}_{kind}.m": _function_file(model, kind, made.outputs[kind]) for kind in OUTPUTS}
    files[f"{name}_currents.m"] = (
        f"function current = {name}_currents(c, qd, qdd, p)\n"
        f"% {name.upper()}_CURRENTS  Motor currents (A): torques of the actuated joints over the drive gains.\n"
        f"  current = {name}_torques(c, qd, qdd, p) ./ [{_list(model.gains)}].';\nend\n"
    )
    fields = {
        "name": name,
        "NAME": name.upper(),
        "home": _list(made.home),
        "actuated": " ".join(str(k + 1) for k in made.actuated),
        "n_c": str(len(made.home) - len(made.presliding)),
    }
    numbers = {"closed": repr(CLOSED), "contraction": repr(CONTRACTION), "condition": repr(CONDITION)}
    if made.step is None or made.last_step is None:
        files[f"{name}_move.m"] = SERIAL_MOVE.format(**fields) + "\n" + _preslide(made)
        files[f"{name}_start.m"] = SERIAL_START.format(**fields)
    else:
        kernels = _kernel(made.step, "newton") + _kernel(made.last_step, "last_newton")
        files[f"{name}_move.m"] = (
            MOVE.format(**fields, **numbers, steps=NEWTON_STEPS) + "\n" + _preslide(made) + kernels
        )
        files[f"{name}_start.m"] = START.format(**fields, steps=STARTING_STEPS)
    files[f"{name}_rest.m"] = REST.format(**fields)
    files[f"{name}_parameters.m"] = _parameters(model, made)
    return files


def _preslide(made: Functions) -> str:
    first, lines = len(made.home) - len(made.presliding) + 1, ""
    for k, (width, ratios) in enumerate(made.presliding, start=first):
        way = " + ".join(f"{r!r} * (moved({place + 1}) - before({place + 1}))" for place, r in ratios.items())
        lines += f"  if before({k}) <= 1, c({k}) = min(max(before({k}) + ({way}) / {width!r}, -1), 1); end\n"
    return PRESLIDE.format(lines=lines) + "\n"


def _function_file(model: Identified, kind: str, function: ca.Function) -> str:
    name, arguments = f"{model.name}_{kind}", ARGUMENTS.get(kind, "c, qd, qdd, p")
    n = len(model.joints)
    still = f"  [qd, qdd] = deal(zeros({n}, 1));\n" if kind in ARGUMENTS else ""
    unit = ", ".join(f"{joint}: {unit}" for joint, unit in zip(model.joints, model.units, strict=True))
    return (
        f"function out = {name}({arguments})\n"
        f"% {name.upper()}  {OUTPUTS[kind][0].upper()}{OUTPUTS[kind][1:]}.\n"
        f"%   c: configuration from {model.name}_start and {model.name}_move.\n"
        "%   qd, qdd: velocities and accelerations of the actuated joints, SI units.\n"
        f"%   p: parameters; {model.name}_parameters has those that were identified.\n"
        f"%   Torques are in N m or N ({unit}).\n"
        f"{_comment(model)}"
        f"{still}  out = reshape(kernel(c, qd, qdd, p), [], {n}).';\nend\n\n" + _kernel(function, "kernel")
    )


def _comment(model: Identified) -> str:
    sentence = " ".join(model.result.friction_law.range_sentence.split())
    return textwrap.fill(sentence, 116, initial_indent="%   ", subsequent_indent="%   ") + "\n"


def _kernel(function: ca.Function, name: str) -> str:
    """Generate CasADi's MATLAB code of a function, in which zeros among its inputs are constants."""
    text = function.export_code("matlab").split("function y=nonzeros_gen")[0]
    text = re.sub(r"nonzeros_gen\((varargin\{\d+\})\)", r"\1(:)", text)
    text = re.sub(r"\bf(max|min)\(", r"\1(", text)
    return re.sub(r"= \w+\(varargin\)", f"= {name}(varargin)", text, count=1).rstrip() + "\n"


def _parameters(model: Identified, made: Functions) -> str:
    lines = [
        f"function model = {model.name}_parameters()",
        f"% {model.name.upper()}_PARAMETERS  Identified parameters, SI units: p is the vector that the functions take.",
        f"  model.joints = {_names(model.joints)};",
        f"  model.drive_gains = [{_list(model.gains)}].'; % torque per current",
        f"  model.names = {_names(each.name for each in model.parameters)};",
        f"  model.units = {_names(each.unit for each in model.parameters)};",
        f"  model.p = [{_list(model.values)}].';",
        f"  model.std = [{_list(np.nan if each.std is None else each.std for each in model.parameters)}].';",
        f"  model.home = [{_list(made.home[made.actuated])}].';",
        "  model.payloads = struct('name', {}, 'p', {}); % parameters with each payload",
    ]
    for load, values in model.payloads.items():
        lines.append(f"  model.payloads(end + 1) = struct('name', {in_matlab(load)}, 'p', [{_list(values)}].');")
    return "\n".join([*lines, "end", ""])


def _names(names: Iterable[str]) -> str:
    return "{" + ", ".join(map(in_matlab, names)) + "}"


def _list(values: Iterable[float]) -> str:
    return " ".join("NaN" if np.isnan(value) else repr(float(value)) for value in values)


def in_matlab(text: str) -> str:
    """Write a text as a string of MATLAB."""
    return "'" + text.replace("'", "''") + "'"


EXPORTS = {"matlab": Export(export)}
