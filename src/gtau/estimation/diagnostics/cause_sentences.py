"""Names and advice for causes: effects that the model may lack, errors in the description."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import asin, atan2, hypot
from typing import Any

from gtau.estimation.diagnostics.finding import FindingKind as F

Values = Mapping[str, Any]
Sentence = tuple[str, str]
"""Reason and advice, of a cause its name and advice, which is empty where there is nothing to do.

Fields in braces are the values of the finding, its ``subject``, its first ``joint`` and the ``other`` one, the
``estimate`` that it is about, the ``cause`` and what ``to_do`` about it.
"""

FILTER = "log at a higher rate, from encoders with less noise, or set 'preparation' by hand"
OTHER_FRICTION = "add runs at other speeds, or with other loads, to separate it from other effects"
INSTRUMENTS = "use --method iv or didim, or encoders with less noise"
NO_GRAVITY = (
    "log the torques of the motors (UR: 'use_currents_as_efforts: true'), or write 'robot: "
    "{{file: ..., gravity: [0, 0, 0]}}' in the experiment file for a model without gravity"
)
DRIFTING_FRICTION = "let the robot warm up before the runs, or split long runs"


def carried(values: Values) -> str:
    """Add the payload to what is to be checked, where some run has one."""
    return ", which runs carry the payload, and on which body" if values.get("payload", True) else ""


def _of_gravity(what: str) -> Callable[[Values], Sentence]:
    to_do = "check the direction of gravity, that the base is level, the sampling rate"
    return lambda values: (what, to_do + carried(values))


def _two_stage(values: Values) -> Sentence:
    signs = (
        "the signs and the payload of every run, and gravity" if values.get("payload", True) else "signs and gravity"
    )
    more = "if these are correct, add runs with other motions: friction that grows with the load has the same effect"
    return "{estimate} by two-stage least squares", f"check {signs}; {more}"


def _clock(values: Values) -> Sentence:
    """Explain residuals that ask for another strength of gravity.

    Time that runs s times too fast makes velocities s and accelerations s^2 times too large, and with them the inertial
    torques against those of gravity, whose length on Earth is known to 0.3 %.
    """
    rate, accelerations = ("high", "large") if values["factor"] > 1 else ("low", "small")
    return (
        f"a sampling rate that is too {rate}, as accelerations are too {accelerations} against gravity (or wrong "
        "lengths throughout the robot)",
        "{clock}; then check the robot's lengths",
    )


def _length(values: Values) -> Sentence:
    bodies = ", ".join(f"'{body}'" for body in values["bodies"])
    return f"a wrong length, such as the {1e3 * values['length']:.4g} mm at {bodies}", "check the robot's geometry"


def _gain_change(values: Values) -> Sentence:
    names, several = " and ".join(f"'{run}'" for run in values["runs"]), len(values["runs"]) > 1
    way = "larger" if values["change"] > 0 else "smaller"
    return (
        f"a current of '{{joint}}' that is {way} in run{'s' * several} {names} than in the others",
        "check which runs carry the payload, its mass and the clock; otherwise let the robot warm up, and alternate "
        "loaded and unloaded runs: a motor's torque constant falls as it warms up"
        if values.get("payload", True)
        else "check the clock; otherwise let the robot warm up: a motor's torque constant falls as it warms up",
    )


def _other_gravity(values: Values) -> Sentence:
    """Name another gravity; where the robot was fitted with it, say what to write."""
    if "left" not in values:  # an estimate to first order
        x, y, z = values["gravity"]
        return _of_gravity(f"a different gravity vector, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2")(values)
    x, y, z = values["gravity"]
    listed = ", ".join(f"{round(each, 3) + 0.0:.4g}" for each in (x, y, z))
    joint, (before, after) = max(values["left"].items(), key=lambda each: each[1][0])
    where, file = "base", f"'gravity: [{listed}]' in the robot file"
    also = " or ".join(_direction(each) for each in values["also"])
    if values["floating"]:
        where = "world"
        file += ", in axes of the logged poses, or turn the poses so that their z axis points up"
    else:
        rpy = f"{atan2(-y, -z) if round(hypot(y, z), 3) else 0.0:.4g}, {asin(x / hypot(x, y, z)) + 0.0:.4g}, 0"
        file += f", or 'base: {{{{rpy: [{rpy}]}}}}' beside its 'file' in the experiment file"
    return (
        f"gravity along {_direction(values['gravity'])}{also and ' or ' + also} of the {where}, which leaves "
        f"{100 * after:.2g} % of '{joint}' unexplained instead of {100 * before:.2g} %,",
        f"check how the {'world axes lie' if values['floating'] else 'base is mounted'}, and write {file}",
    )


def _without_gravity(values: Values) -> Sentence:
    joint, (before, after) = max(values["left"].items(), key=lambda each: each[1][0])
    return (
        "torques without gravity, as from a driver that compensates it, which leaves "
        f"{100 * after:.2g} % of '{joint}' unexplained instead of {100 * before:.2g} %,",
        NO_GRAVITY,
    )


def _wrench_offset(values: Values) -> Sentence:
    if "component" in values:
        what = f"an offset in the {values['component']} of the wrench on '{{subject}}'"
    else:
        force, moment = (", ".join(f"{each:.2g}" for each in values[part]) for part in ("force", "moment"))
        what = f"an offset of ({force}) N and ({moment}) N m in the wrench on '{{subject}}'"
    return what, "tare the unloaded force sensor before each run, or subtract its unloaded reading"


def _wrench_point(values: Values) -> Sentence:
    if "axis" in values:
        off = f"off in {values['axis']}"
    else:
        off = f"off by ({', '.join(f'{1e3 * each:.2g}' for each in values['shift'])}) mm"
    return (
        f"the reference point of the moment on '{{subject}}', {off}",
        "measure the position of the sensor, and correct 'at' of that wrench",
    )


def _direction(gravity: Sequence[float]) -> str:
    """Name an axis, or write a direction of unit length."""
    size = hypot(*gravity)
    unit = [round(each / size, 2) + 0.0 for each in gravity]
    along = [k for k in range(3) if unit[k]]
    if len(along) == 1:
        return f"{'-' if unit[along[0]] < 0 else '+'}{'xyz'[along[0]]}"
    return "({:.2g}, {:.2g}, {:.2g})".format(*unit)


CAUSES: Mapping[F, Sentence | Callable[[Values], Sentence]] = {
    F.CUBIC_FRICTION: ("cubic friction of '{joint}'", OTHER_FRICTION),
    F.LOAD_FRICTION: ("load-dependent friction of '{joint}'", OTHER_FRICTION),
    F.STRIBECK_FRICTION: ("Stribeck friction of '{joint}'", OTHER_FRICTION),
    F.VISCOUS_DRIFT: ("viscous friction of '{joint}' changing along the runs", DRIFTING_FRICTION),
    F.COULOMB_DRIFT: ("Coulomb friction of '{joint}' changing along the runs", DRIFTING_FRICTION),
    F.SATURATION: (
        "the torque constant of '{joint}' falling with its current",
        "stay at lower currents, with slower motions or less load, and check that the log holds the actual "
        "current; friction that grows with the load has the same effect",
    ),
    F.GAIN_DRIFT: ("the torque constant of '{joint}' falling along the runs", "let the robot warm up before the runs"),
    F.CURRENT_LAG: (
        "a low-pass filter of the current of '{joint}', or an elastic transmission",
        "log the current before any filter, and move more slowly",
    ),
    F.ENCODER_ZERO: (
        "an error in the zero of encoder '{joint}'",
        "compare the encoder zeros with the robot's zero position",
    ),
    F.GRAVITY_TILT: _of_gravity("gravity tilted towards ({towards[0]:.2g}, {towards[1]:.2g}, {towards[2]:.2g})"),
    F.GRAVITY_STRENGTH: _of_gravity("a different magnitude of gravity"),
    F.GRAVITY: _other_gravity,
    F.WITHOUT_GRAVITY: _without_gravity,
    F.WRENCH_OFFSET: _wrench_offset,
    F.WRENCH_POINT: _wrench_point,
    F.CLOCK: _clock,
    F.LENGTH: _length,
    F.GAIN_CHANGE: _gain_change,
    F.BANDWIDTH: ("{estimate} with a bandwidth {factor:g} times as large", FILTER),
    F.SLOW_ROWS: (
        "{estimate} without rows below {fraction:.2g%} of a joint's rms speed",
        "use motions with fewer reversals, or set 'preparation' by hand",
    ),
    F.TWO_STAGE: _two_stage,
    F.INSTRUMENTS: ("{estimate} by instrumental variables", INSTRUMENTS),
}
