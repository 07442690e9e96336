"""Sentences for findings against estimates: reason and advice."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from gtau.findings.kind import FindingKind as F
from gtau.findings.note_words import IMPOSSIBLE, PRIOR, SCALE
from gtau.findings.words import (
    LISTED,
    RELATIVE,
    Sentence,
    Values,
    Words,
    literal,
    percent_text,
    which_payload,
    write_limits,
)

MOVED = 10.0  # of itself: a gain that moves by more was no estimate
THOUSAND = 2.0  # a factor between 1000 / 2 and 1000 * 2 is one of a thousand
WRENCHES = (
    "check the signs, axes, point ('at') and body of each wrench, that no wrench is missing, and that all use the "
    "clock of the positions"
)
LOADED = (
    "use a heavier payload, longer runs, or motions in which the joint lifts or accelerates it more; if other joints "
    "are weak too, check which runs carry the payload, on which body, and gravity"
)
MAY_BE_WRENCHES = {F.SWAPPED, F.REVERSED, F.ALL_NEGATIVE, F.REFUTED, F.UNEXPLAINED, F.OTHER_ESTIMATOR}
SENSOR = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"


def _refuted(values: Values) -> Sentence:
    size = (
        " ({size:.2g%} of itself)" if values["unit"] == RELATIVE else " ({size:.2g} {unit})" if values["unit"] else ""
    )
    explains = " would explain {share:.0f%} of the residual variance"
    if "move" in values:
        large = abs(values["move"]) > MOVED
        turned = "reverse the sign of this gain" if values["move"] < -1 else "move this gain by {move:+.2g%}"
        explains += " and " + (f"move this gain by more than {100 * MOVED:.0f} %" if large else turned)
    return "{cause}" + size + explains, "{to_do}"


def _unexplained(values: Values) -> Sentence:
    return (
        "the model leaves {share:.0f%} of the joint's {kind} unexplained",
        "check the position and {kind} columns, their signs and units, the clock of the log, and 'preparation'"
        if values["given"]
        else "check that the position and current columns are of the same joint in all runs, and check their signs "
        "and units",
    )


def _prior_gain(values: Values) -> Sentence:
    to_do = "check the payload's mass (kg), the unit of the currents, and 'prior_gains'"
    if 1000 / THOUSAND < values["ratio"] < 1000 * THOUSAND:
        to_do = "check the payload's mass (g entered as kg?) and the unit of the currents (A declared as mA?)"
    if 0.001 / THOUSAND < values["ratio"] < 0.001 * THOUSAND:
        to_do = "check the unit of the currents (mA declared as A?) and the payload's mass in kg"
    return "it is {ratio:.4g} times its prior of {prior:.4g} {unit}", to_do


def _turned(values: Values) -> Sentence:
    what = f"positive {values['kind']} drives the joint {'backwards' if values['negative'] else 'forwards'}"
    state = (
        "the prior gain" if values["prior"] else "the drive does turn against its joint, state a negative prior gain"
    )
    return (
        f"{'negative' if values['negative'] else 'positive'} gain: {what}",
        f"reverse the sign of its {values['kind']} or position column; or if "
        + (f"that is intended, reverse {state}" if values["prior"] else state),
    )


def _effort(values: Values) -> Sentence:
    cause = f"the unit of the {values['kind']}s" if values["given"] else "the payload's mass, which sets the scale,"
    return (
        "the torque of '{subject}' is {torque:.3g} {unit} (rms), {ratio:.3g} times its limit of {limit:.4g} {unit}"
        + f", so {cause} may be wrong" * values["all"],
        f"check the payload's mass (kg) and the unit of the {values['kind']}s; if the limit is a placeholder, "
        + literal(write_limits(values["subject"])),
    )


def _lost(why: str) -> Callable[[Values], Sentence]:
    def sentence(values: Values) -> Sentence:
        loaded = (
            "use a heavier payload, and motions in which the joint lifts or accelerates it; check the direction of "
        )
        return why, loaded + "gravity" + which_payload(values) if values["payload"] else _unloaded(values)

    return sentence


def _unloaded(values: Values) -> str:
    """Advise motions; a payload only where no wrench gives the scale, of which the payload might be a part."""
    motions = "longer runs, motions in which the joint lifts or accelerates more"
    payload = "" if values.get("wrenches") else ", or also a payload of known mass"
    return f"use {motions}{payload}; check the direction of gravity"


def _wide(why: str, to_do: str = "", more: bool = True) -> Callable[[Values], Sentence]:
    """Make the sentence of a wide interval, with the advice against its random part where that is too wide alone."""

    def sentence(values: Values) -> Sentence:
        width = percent_text(100 * values["half"], 100 * values["accuracy"])
        longer = "; also use a heavier payload and longer runs" if values["payload"] else "; also use longer runs"
        return f"the 95 % interval is +-{width} %{why}", to_do + longer * (more and values["random"])

    return sentence


def _late(values: Values) -> Sentence:
    way = "late" if values["lag"] > 0 else "early"
    return (
        f"the {{kind}}s were logged {1e3 * abs(values['lag']):.0f} ms too {way}: {{shifted:.2g%}} is unexplained "
        "after shifting them, {as_logged:.2g%} as logged{also}",
        "log them with the time stamps of the positions, or if those of all joints are equally late, write "
        "'preparation: "
        f"{{{{delay: {values['lag']:.3g}}}}}'",
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
    scale = "the unit and scale of the torques" if values["given"] == "torque" else "the given gains"
    way = "leave out --method" if values["given"] == "torque" else "identify the gains"
    return (
        f"check which runs carry the payload, its mass (kg) and {scale}; if the mass is certain, {way}: it then "
        "sets their scale"
    )


VERDICT_WORDS: Mapping[str, Words] = {
    F.NEGATIVE_MASS: (
        "the wrenches imply a robot mass of {mass:.3g} kg",
        "log the forces exerted on the body, not by it, or reverse their signs",
    ),
    F.BASE_UNEXPLAINED: ("the model leaves {share:.0f%} of the {part} on the base '{subject}' unexplained", WRENCHES),
    F.TLS_CONFUSED: lambda values: (
        "total least squares cannot separate the payload from the noise (standard deviation over "
        f"{100 * values.get('limit', 0.5):g} %)",
        "use --method ml, or a heavier payload and longer runs with less noise",
    ),
    F.ALL_NEGATIVE: lambda values: (
        "all drive gains are negative",
        "check the sign of the currents and positions, gravity" + which_payload(values),
    ),
    F.SWAPPED: lambda values: (
        f"the {{kind}}s of {values['listed']} look "
        + ("swapped" if values["count"] == 2 else "permuted")
        + ": {exchanged:.2g%} is unexplained after exchanging them, {as_logged:.2g%} as logged{also}",
        "check that the position and {kind} columns are of the same joint in all runs",
    ),
    F.MAGNITUDES: (
        "the {kind}s of {listed} look like magnitudes: {exchanged:.2g%} is unexplained with signs that fit the motion, "
        "{as_logged:.2g%} as logged{also}",
        "log signed values (some drives store the sign in a separate bit or column)",
    ),
    F.REVERSED: (
        "the {kind}s of {listed} look reversed: the parameters that joints share, or the inertias of the robot file, "
        "contradict their sign{also}",
        "check the signs of the {kind} and position columns",
    ),
    F.LATE: _late,
    F.FROZEN: lambda values: (
        "the position of '{joint}' never changes in run '{run}', but {share:.2g%} of the {kind} of '{other}' is then "
        "unexplained" + (", {usual:.2g%} in other runs" if values["usual"] else "") + ", so it moved",
        "check the encoder and the position column of '{joint}' in that run, and log it again",
    ),
    F.REFUTED: _refuted,
    F.UNEXPLAINED: _unexplained,
    F.PAYLOAD: lambda values: (
        "payload '{subject}', which contradicts the data, leaves this joint unexplained"
        if values.get("given")
        else "the scale comes from payload '{subject}', which contradicts the data",
        "correct the payload",
    ),
    F.SENSOR: lambda values: (
        f"the scale comes from the {values.get('sensor', 'torque sensor')} of "
        "'{subject}', which contradicts all other data",
        SENSOR,
    ),
    F.WHOLE_MASS: ("the mass of the robot, {subject}, " + PRIOR, SCALE),
    F.UNSETTLED: (
        "the iteration did not converge, so the data do not determine it",
        "resolve the contradictory joints first",
    ),
    F.LOST: _lost("the relative standard deviation is {std:.0f%}"),
    F.SIGN_OPEN: _lost("the 95 % interval includes zero"),
    F.OTHER_ESTIMATOR: _other_estimator,
    F.PRIOR_GAIN: _prior_gain,
    F.NEGATIVE_GAIN: _turned,
    F.GAINS_APART: (
        "its gain of {gain:.3g} {unit} and that of '{subject}', {of_peer:.3g} {unit}, differ by a factor of "
        "{ratio:.2g}, which is implausible for motors and gears of one robot",
        "check that the {kind} columns of these joints are in the same unit, and convert those that are not; if the "
        "motors do differ, state 'prior_gains'",
    ),
    F.HEAVY_PAYLOAD: lambda values: (
        "payload '{subject}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about {most:.3g} kg "
        "at most); all drive gains are proportional to it",
        f"if it is in g, write 'mass: {values['mass'] / 1000:.4g}' (kg); otherwise state 'prior_gains'",
    ),
    F.LARGE_CURRENT: (
        "the current of joint '{subject}' is {rms:.4g} A rms, more than drives of robots take",
        "if it is in mA, write units: {{current: mA}}; otherwise state 'prior_gains'",
    ),
    F.UNLIKE_FILE: (
        "the first moments of the links are {factor:.3g} times those of the robot's file (rms of {count})",
        "check the payload's mass (kg), the unit of the torques, and the masses in the file; if the file is wrong, "
        "state 'prior_gains'",
    ),
    F.EFFORT: _effort,
    F.DOUBTFUL_LIMIT: _effort,
    F.IMPOSSIBLE_PARAMETERS: lambda values: (
        "physically impossible parameters: "
        + ", ".join(
            f"{name} = {value:.3g} {unit} (standard deviation {std:.2g})"
            for name, value, std, unit in values["parameters"][:LISTED]
        )
        + f" and {len(values['parameters']) - LISTED} more" * (len(values["parameters"]) > LISTED),
        IMPOSSIBLE,
    ),
    F.WIDE_SCALE: _wide(
        ", limited by the uncertainty of its scale reference",
        "calibrate the sensors, or weigh the payload, more accurately",
        more=False,
    ),
    F.WIDE_RANDOM: lambda values: _wide("", LOADED if values["payload"] else _unloaded(values), more=False)(values),
    F.WIDE_RIPPLE: _wide(
        ", because residuals repeat at the same positions (motor ripple, cables or springs)",
        "use other paths in the loaded and unloaded runs",
    ),
    F.WIDE_CAUSE: _wide(", because the data cannot exclude {cause}", "{to_do}"),
    F.COUPLED: (
        "joint '{subject}' contradicts the model, whose parameters all joints share",
        "resolve that joint first",
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
        "add runs with different motions of the joints",
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
    F.NEGATIVE_PAYLOAD: (
        "its mass of {mass:.4g} kg (standard deviation {std:.2g}) is negative, which no body has",
        "check which runs carry it, as the others may be the loaded ones, the signs of the commands, and gravity",
    ),
    F.PAYLOAD_MASS: lambda values: (
        "all other data give it a mass of {found:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg",
        _given_scale(values) or "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared",
    ),
    F.PAYLOAD_PARAMETER: (
        "given its mass and all other data, its {parameter} is {found:.4g} {unit} (standard deviation {std:.2g}), not "
        "{declared:.4g} {unit}",
        "check {parameter}, its frame (that of the body that carries the payload) and the mass; or omit {parameter}",
    ),
    F.SENSOR_SCALE: (
        "all other data give torques {scale:.4g} times its reading (standard deviation {std:.2g})",
        SENSOR,
    ),
}
