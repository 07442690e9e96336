"""The words for every kind of finding: reason and advice. No other module writes them, and none reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil, floor, log10, sqrt, tau
from typing import Any

from gtau.estimation.diagnostics.finding import RELATIVE, Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.regression.motion_limits import clock_advice
from gtau.estimation.thresholds.estimates import LOST_GAIN
from gtau.signals.notes import Kind, Note

Values = Mapping[str, Any]
Sentence = tuple[str, str]
"""Reason and advice, of a cause its name and advice, which is empty where there is nothing to do.

Fields in braces are the values of the finding, its ``subject``, its first ``joint`` and the ``other`` one, the
``estimate`` that it is about, the ``cause`` and what ``to_do`` about it.
"""

LISTED = 3  # parameters that are named
THOUSAND = 2.0  # a factor between 1000 / 2 and 1000 * 2 is one of a thousand
WRENCHES = (
    "check the signs, axes, point ('at') and body of each wrench, that none is missing, and that they share the "
    "positions' clock"
)
LOADED = (
    "use a heavier payload, longer runs, or motions in which this joint lifts or accelerates it more; if other joints "
    "are weak too, check which runs carry the payload, on which body, and gravity"
)
UNLOADED = (
    "use longer runs, motions in which this joint lifts or accelerates more, or also a payload of known mass; check "
    "the direction of gravity"
)
GRAVITY = (
    "check the direction of gravity, that the base is level, the sampling rate, which runs carry the payload, and on "
    "which body"
)
SCALE = "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"
SENSOR = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"
FILTER = "log at a higher rate, from encoders with less noise, or give 'preparation' by hand"
OTHER_FRICTION = "add runs at other speeds, or with other loads, to separate it from the rest"
INSTRUMENTS = "use --method iv or didim, or encoders with less noise"
DRIFTING_FRICTION = "let the robot warm up before the runs, or split long runs"


def reason(finding: Finding) -> str:
    """Say what was found; of a cause, name it."""
    return _sentence(finding)[0]


def advice(finding: Finding) -> str:
    """Say what to do about it, wrenches first where they may be the cause."""
    found = _sentence(finding)[1]
    return f"{WRENCHES}; otherwise {found}" if finding.values.get("wrenches") else found


def named(causes: Sequence[Finding]) -> str:
    """Name causes that have the same effect."""
    return " or ".join(dict.fromkeys(map(reason, causes)))


def note(finding: Finding) -> Note:
    """Write a finding as a note."""
    joint = finding.joints[0] if len(finding.joints) == 1 else ""
    kind = NOTES.get(finding.kind, Kind.MODEL)
    return Note(kind, reason(finding), advice(finding), joint=joint, finding=finding.kind)


def percent_text(share: float, accuracy: float | None = None) -> str:
    """Write a share (per cent) in two significant digits and at most two decimals, without the sign of per cent.

    A share that exceeds the ``accuracy`` (per cent) is rounded up where it would be rounded to it or below.
    """
    if 0 < share < 0.005:
        return "<0.01"
    decimals = min(max(1 - floor(log10(float(f"{share:.2g}"))), 0), 2) if share else 2
    shown = f"{share:.{decimals}f}"
    if accuracy is not None and share > accuracy >= float(shown):
        shown = f"{ceil(share * 10**decimals) / 10**decimals:.{decimals}f}"
    return shown


class _Number(float):
    """A value in a template; a format that ends with ``%`` prints a ratio in per cent."""

    def __format__(self, spec: str) -> str:
        return f"{100 * self:{spec[:-1]}} %" if spec.endswith("%") else float.__format__(self, spec)


def _sentence(finding: Finding) -> Sentence:
    found = SENTENCES[finding.kind]
    what, to_do = found if isinstance(found, tuple) else found(_literal(finding.values))
    values = {key: _Number(each) if isinstance(each, float) else each for key, each in finding.values.items()}
    values["subject"], values["estimate"] = finding.subject, finding.subject or "estimates"
    if finding.joints:
        values["joint"], values["other"] = finding.joints[0], finding.joints[-1]
        values["estimate"] = f"the gain of '{finding.joints[0]}'"
    if finding.causes:
        values["cause"], values["to_do"] = named(finding.causes), advice(finding.causes[0])
    values["clock"] = clock_advice(finding.values.get("rate"))
    return what.format(**values), to_do.format(**values)


def _literal(value: Any) -> Any:
    """Double the braces of names, which the functions put into templates."""
    if isinstance(value, str):
        return value.replace("{", "{{").replace("}", "}}")
    if isinstance(value, Mapping):
        return {key: _literal(each) for key, each in value.items()}
    return tuple(map(_literal, value)) if isinstance(value, list | tuple) else value


def _refuted(values: Values) -> Sentence:
    size = (
        " ({size:.2g%} of itself)" if values["unit"] == RELATIVE else " ({size:.2g} {unit})" if values["unit"] else ""
    )
    explains = " would explain {share:.0f%} of the residual variance and move this gain by {move:+.2g%}"
    return "{cause}" + size + explains, "{to_do}"


def _unexplained(values: Values) -> Sentence:
    return (
        "the model leaves {share:.0f%} of this joint's {kind} unexplained",
        "check its position and {kind} columns, their signs and units, the clock of the log and its 'preparation'"
        if values["given"]
        else "check that its position and current columns belong together, in all runs, and their signs and units",
    )


def _prior_gain(values: Values) -> Sentence:
    to_do = "check the payload's mass (kg), the unit of the currents, and 'prior_gains'"
    if 1000 / THOUSAND < values["ratio"] < 1000 * THOUSAND:
        to_do = (
            "check the payload's mass, which looks like g taken for kg, and the unit of the currents, A taken for mA"
        )
    if 0.001 / THOUSAND < values["ratio"] < 0.001 * THOUSAND:
        to_do = "check the unit of the currents, which looks like mA taken for A, and the payload's mass in kg"
    return "it is {ratio:.4g} times its prior of {prior:.4g} {unit}/A", to_do


def _lost(why: str) -> Callable[[Values], Sentence]:
    loaded = (
        "use a heavier payload, and motions in which this joint lifts or accelerates it; check the direction of "
        "gravity, which runs carry the payload, and on which body"
    )
    return lambda values: (why, loaded if values["payload"] else UNLOADED)


def _wide(why: str, to_do: str = "", more: bool = True) -> Callable[[Values], Sentence]:
    """Make the sentence of a wide interval, with the advice against its random part where that is too wide alone."""

    def sentence(values: Values) -> Sentence:
        width = percent_text(100 * values["half"], 100 * values["accuracy"])
        longer = "; use a heavier payload and longer runs, too" if values["payload"] else "; use longer runs, too"
        return f"its 95 % interval is +-{width} %{why}", to_do + longer * (more and values["random"])

    return sentence


def _ripple(values: Values) -> Sentence:
    base = bool(values["base"])
    where = "of the base '{subject}'" if base else "at joint '{joint}'"
    cause = "a wrench is wrong or missing" if base else "ripple of the motors, cables or springs, which the model lacks"
    of_gain = " (that of the gain of joint '{moved}' {move:.3g%})" if values["move"] else ""
    return (
        f"residuals repeat at the same positions ({{share:.0f%}} of the variance {where}): {cause}. They repeat in "
        "every run, so the scatter between blocks does not show them; the standard deviations include how far the "
        f"estimates move when they are modelled{of_gain}",
        "",
    )


def _between_runs(values: Values) -> str:
    listed = ", ".join(f"'{joint}' ({value:+.2f})" for joint, value in values["correlations"])
    return "residuals of runs that repeat a motion with different loads are correlated at " + listed


def _command_lag(values: Values) -> Sentence:
    lag, phase = values["lag"], tau * values["bandwidth"] * values["lag"]
    size = f"by {1e3 * lag:.2g} ms (standard deviation {1e3 * values['std']:.2g} ms)"
    size = size if phase < 1 else f"by more than {1e3 * lag / phase:.2g} ms"
    return (
        f"the {{kind}}s lag behind the motion {size}, so they look low-passed, held or logged late; a low-pass of that "
        f"time constant attenuates them by {100 * (1 - 1 / sqrt(1 + phase**2)):.2g} % at the bandwidth of the motion, "
        "{bandwidth:.3g} Hz",
        "log the {kind}s before any filter and with the time stamps of the positions",
    )


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
        "loaded and unloaded runs, as a motor's torque constant falls as it warms up",
    )


def _other_estimator(values: Values) -> Sentence:
    way = "larger" if values["move"] > 0 else "smaller"
    return (
        f"2SLS on the same data gives a gain {100 * abs(values['move']):.2g} % {way}, a difference of "
        f"{abs(values['t']):.0f} standard deviations",
        "{to_do}",
    )


def _given_scale(values: Values) -> str:
    """Say what to do about a mass that contradicts gains that are given; empty where they are estimated."""
    if not values.get("given"):
        return ""
    scale = "the unit and scale of the torques" if values["given"] == "torque" else "the gains that are given"
    way = "declare torques of doubtful scale as 'current'" if values["given"] == "torque" else "identify the gains"
    return (
        f"check which runs carry the payload, its mass (kg) and {scale}; where the mass is certain, {way}, and it "
        "gives their scale"
    )


PRIOR = "is {found:.4g} from the data (standard deviation {std:.2g}), but {prior:.4g} from its prior ({prior_std:.2g})"
IMPOSSIBLE = "check the signs of positions and currents, the sampling rate, the units and 'preparation'"

SENTENCES: Mapping[F, Sentence | Callable[[Values], Sentence]] = {
    F.NEGATIVE_MASS: (
        "the wrenches give the robot a mass of {mass:.3g} kg",
        "log the forces on the body, or reverse their signs",
    ),
    F.BASE_UNEXPLAINED: ("the model leaves {share:.0f%} of the {part} on the base '{subject}' unexplained", WRENCHES),
    F.TLS_CONFUSED: (
        f"total least squares cannot separate the payload from the noise (standard deviation over {100 * LOST_GAIN:g} "
        "%)",
        "use --method ml, or a heavier payload and longer runs with less noise",
    ),
    F.ALL_NEGATIVE: (
        "all drive gains are negative",
        "check the sign of the currents and positions, gravity, which runs carry the payload, and on which body",
    ),
    F.SWAPPED: (
        "the {kind}s of '{joint}' and '{other}' look swapped: exchanged, {exchanged:.2g%} of them is unexplained, as "
        "logged {as_logged:.2g%}",
        "check that position and {kind} columns belong together, in all runs",
    ),
    F.REFUTED: _refuted,
    F.UNEXPLAINED: _unexplained,
    F.PAYLOAD: lambda values: (
        "payload '{subject}', which contradicts the data, leaves this joint unexplained"
        if values.get("given")
        else "it rests on payload '{subject}', which contradicts the data",
        "correct the payload",
    ),
    F.SENSOR: ("it rests on the torque sensor of '{subject}', which contradicts all other data", SENSOR),
    F.WHOLE_MASS: ("the mass of the robot, {subject}, " + PRIOR, SCALE),
    F.UNSETTLED: (
        "the iteration did not converge, so the data do not determine it",
        "resolve the contradictory joints first",
    ),
    F.LOST: _lost("its relative standard deviation is {std:.0f%}"),
    F.SIGN_OPEN: _lost("the 95 % interval includes zero"),
    F.OTHER_ESTIMATOR: _other_estimator,
    F.PRIOR_GAIN: _prior_gain,
    F.EFFORT: (
        "at this gain the torque is {torque:.3g} {unit} (rms), {ratio:.3g} times the joint's limit of {limit:.4g} "
        "{unit}",
        "check the payload's mass (kg), the unit of the currents, and 'limits: effort' in the robot file",
    ),
    F.WIDE_SCALE: _wide(
        ", limited by the uncertainty of its scale reference",
        "calibrate the sensors, or weigh the payload, more accurately",
        more=False,
    ),
    F.WIDE_RANDOM: lambda values: _wide("", LOADED if values["payload"] else UNLOADED, more=False)(values),
    F.WIDE_RIPPLE: _wide(
        ", as residuals repeat at the same positions (ripple of the motors, cables or springs)",
        "use other paths in the loaded and unloaded runs",
    ),
    F.WIDE_CAUSE: _wide(", as the data cannot exclude {cause}", "{to_do}"),
    F.COUPLED: (
        "joint '{subject}' contradicts the model, whose parameters all joints share",
        "resolve that joint first",
    ),
    F.NEGATIVE_GAIN: (
        "negative gain, as positive current drives the joint backwards",
        "reverse the sign of current or position if that is not intended",
    ),
    F.DELAY_NOISE: (
        "the current's rate of change may be nothing but noise",
        "treat it as unknown, or move this joint faster; the drive gain does not depend on it",
    ),
    F.DELAY_UNCERTAIN: lambda values: (
        f"its standard deviation is {1e3 * values['std']:.2g} ms",
        "treat it as a nuisance parameter, or move this joint faster",
    ),
    F.INSEPARABLE: (
        "these motions cannot separate it from the parameters listed before it",
        "add runs that move the joints in other ways",
    ),
    F.NEAR_ZERO: (
        "it is within two standard deviations of zero",
        "treat it as small, or move its joint faster and further",
    ),
    F.UNCERTAIN: ("its standard deviation is {std:.0f%}", "add longer runs"),
    F.IMPOSSIBLE: lambda values: (
        "it is negative by {t:.0f} standard deviations: "
        + ("friction that drives the joint" if values["friction"] else "a negative inertia"),
        IMPOSSIBLE,
    ),
    F.PAYLOAD_MASS: lambda values: (
        "by all other data it weighs {found:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg",
        _given_scale(values)
        or "weigh the payloads again; one of the masses is wrong, or a run carries another payload than declared",
    ),
    F.PAYLOAD_PARAMETER: (
        "given its mass and all other data its {parameter} is {found:.4g} {unit} (standard deviation {std:.2g}), not "
        "{declared:.4g} "
        "{unit}",
        "check {parameter} and the frame it is given in, that of the body that carries the payload, and the mass; or "
        "leave {parameter} out",
    ),
    F.SENSOR_SCALE: (
        "all other data give torques {scale:.4g} times its reading (standard deviation {std:.2g})",
        SENSOR,
    ),
    F.UNLIKE_LEGS: lambda values: (
        "legs of the same geometry differ, most in {parameter} of leg '{subject}' ("
        + ("{share:.0f%}" if values["share"] < 10 else "more than 1000 %")
        + " from the mean of the others)",
        "check that they are built alike",
    ),
    F.PRIOR: ("the known parameter {subject} " + PRIOR, SCALE),
    F.POSITION_NOISE: (
        "position noise biases {count} of {all} estimates by more than their standard deviations: {estimate} by "
        "{deviations:.1f} of them (instrumental variables, which such noise does not bias, differ by {t:.0f} standard "
        "deviations of the difference); the intervals include it",
        INSTRUMENTS,
    ),
    F.RIPPLE: _ripple,
    F.COMMON_RESIDUALS: lambda values: (
        f"{_between_runs(values)}: what the model lacks there depends on the motion alone, and cancels in the gains",
        "",
    ),
    F.OPPOSED_RESIDUALS: lambda values: (
        f"{_between_runs(values)}: what the model lacks there changes sign with the load, and moves gains; most likely "
        "{cause}",
        "{to_do}",
    ),
    F.SMALL_REFUTATION: (
        "{cause} would explain {share:.0f%} of the residual variance and move no gain by more than {move:.2g%}",
        "{to_do}",
    ),
    F.WEAK_INSTRUMENTS: (
        "two-stage least squares could not be compared: these motions leave its instruments weak (first-stage F of "
        "{strength:.2g}, where it needs {needed:.2g}), so that it would differ by its own bias",
        "let the joints move independently of each other, or use a heavier payload",
    ),
    F.UNTESTED: ("{cause} could not be made for comparison: {refusal}", ""),
    F.AUTOCORRELATED: (
        "residuals are autocorrelated: standard errors are {factor:.1f} times those of white noise, so the model lacks "
        "something, such as friction of another kind, ripple of the motors, cables or elasticity",
        "",
    ),
    F.IMPOSSIBLE_PARAMETERS: lambda values: (
        "physically impossible parameters: "
        + ", ".join(f"{name} = {value:.3g} {unit}" for name, value, unit in values["parameters"][:LISTED])
        + f" and {len(values['parameters']) - LISTED} more" * (len(values["parameters"]) > LISTED),
        IMPOSSIBLE,
    ),
    F.NOT_SEPARATED: lambda values: (
        f"these motions cannot separate {', '.join(values['parameters'])} from the other base parameters: no value is "
        "given",
        "add runs that move all joints in other ways",
    ),
    F.FEW_ROWS: (
        "the tests of the model were skipped, as the robot moves too little for them ({rows} rows in the middle of the "
        "runs, for {unknowns} unknowns): the intervals hold scatter alone",
        "log longer motions",
    ),
    F.COMMAND_LAG: _command_lag,
    F.SLIGHT_COMMAND_LAG: _command_lag,
    F.CUBIC_FRICTION: ("cubic friction of '{joint}'", OTHER_FRICTION),
    F.LOAD_FRICTION: ("load-dependent friction of '{joint}'", OTHER_FRICTION),
    F.STRIBECK_FRICTION: ("Stribeck friction of '{joint}'", OTHER_FRICTION),
    F.VISCOUS_DRIFT: ("viscous friction of '{joint}' changing along the runs", DRIFTING_FRICTION),
    F.COULOMB_DRIFT: ("Coulomb friction of '{joint}' changing along the runs", DRIFTING_FRICTION),
    F.SATURATION: (
        "the torque constant of '{joint}' falling with its current",
        "stay at lower currents, with slower motions or a lighter payload, and check that the log holds the actual "
        "current; friction that grows with the load has the same effect",
    ),
    F.GAIN_DRIFT: ("the torque constant of '{joint}' falling along the runs", "let the robot warm up before the runs"),
    F.CURRENT_LAG: (
        "a low-pass filter of the current of '{joint}', or an elastic transmission",
        "log the current before any filter, and move more slowly",
    ),
    F.ENCODER_ZERO: (
        "an error in the zero of encoder '{joint}'",
        "check the zeros of the encoders against the robot's own",
    ),
    F.GRAVITY_TILT: ("gravity tilted towards ({towards[0]:.2g}, {towards[1]:.2g}, {towards[2]:.2g})", GRAVITY),
    F.GRAVITY_STRENGTH: ("gravity of another strength", GRAVITY),
    F.GRAVITY: ("another gravity, about ({gravity[0]:.1f}, {gravity[1]:.1f}, {gravity[2]:.1f}) m/s2", GRAVITY),
    F.CLOCK: _clock,
    F.LENGTH: _length,
    F.GAIN_CHANGE: _gain_change,
    F.BANDWIDTH: ("{estimate} with a bandwidth {factor:g} times as large", FILTER),
    F.SLOW_ROWS: (
        "{estimate} without rows below {fraction:.2g%} of a joint's rms speed",
        "make motions with fewer reversals, or give 'preparation' by hand",
    ),
    F.TWO_STAGE: (
        "{estimate} by two-stage least squares",
        "check the signs and the payload of every run, and gravity; otherwise add runs of other motions, as friction "
        "that grows with the load has the same effect",
    ),
    F.INSTRUMENTS: ("{estimate} by instrumental variables", INSTRUMENTS),
}

NOTES: Mapping[F, Kind] = {
    F.POSITION_NOISE: Kind.NOISE,
    F.COMMAND_LAG: Kind.FILTERED,
    F.SLIGHT_COMMAND_LAG: Kind.READING,
    F.UNTESTED: Kind.READING,
    F.COMMON_RESIDUALS: Kind.READING,
    F.WEAK_INSTRUMENTS: Kind.READING,
    F.NOT_SEPARATED: Kind.SEPARATION,
}
"""Kinds of the notes that are not on the model."""
