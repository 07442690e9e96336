"""Sentences for findings against estimates: reason and advice."""

from __future__ import annotations

from collections.abc import Mapping

from gtau.findings.kind import FindingKind as F
from gtau.findings.note_words import IMPOSSIBLE, PRIOR, SCALE, UNLOADED, WHICH_PAYLOAD, some
from gtau.findings.words import RELATIVE, Sentence, Values, Words

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
LOST = (
    "<payload?use a heavier payload, and motions in which the joint lifts or accelerates it; check the direction of "
    f"gravity{WHICH_PAYLOAD}|{UNLOADED}>"
)
WIDE = "the 95 % interval is +-{width} %"
LONGER = "<random?; also use <payload?a heavier payload and longer runs|longer runs>>"
"""Advice against the random part of an interval, where that is too wide alone."""
MAY_BE_WRENCHES = {F.SWAPPED, F.REVERSED, F.ALL_NEGATIVE, F.REFUTED, F.UNEXPLAINED, F.OTHER_ESTIMATOR}
SENSOR = "check the sensor's calibration, unit and joint; a payload's mass or a known parameter may be wrong too"
EFFORT = (
    "the torque of '{subject}' is {torque:.3g} {unit} (rms), {ratio:.3g} times its limit of {limit:.4g} {unit}"
    "<all?, so <given?the unit of the {kind}s|the payload's mass, which sets the scale,> may be wrong>",
    "check the payload's mass (kg) and the unit of the {kind}s; if the limit is a placeholder, {limits}",
)


def _refuted(values: Values) -> Sentence:
    size = " ({size:.2g%} of itself)" if values["unit"] == RELATIVE else "<unit? ({size:.2g} {unit})>"
    explains = " would explain {share:.0f%} of the residual variance"
    if "move" in values:
        large = abs(values["move"]) > MOVED
        turned = "reverse the sign of this gain" if values["move"] < -1 else "move this gain by {move:+.2g%}"
        explains += " and " + (f"move this gain by more than {100 * MOVED:.0f} %" if large else turned)
    return "{cause}" + size + explains, "{to_do}"


def _prior_gain(values: Values) -> Sentence:
    to_do = "check the payload's mass (kg), the unit of the currents, and 'prior_gains'"
    if 1000 / THOUSAND < values["ratio"] < 1000 * THOUSAND:
        to_do = "check the payload's mass (g entered as kg?) and the unit of the currents (A declared as mA?)"
    if 0.001 / THOUSAND < values["ratio"] < 0.001 * THOUSAND:
        to_do = "check the unit of the currents (mA declared as A?) and the payload's mass in kg"
    return "it is {ratio:.4g} times its prior of {prior:.4g} {unit}", to_do


VERDICT_WORDS: Mapping[str, Words] = {
    F.NEGATIVE_MASS: (
        "the wrenches imply a robot mass of {mass:.3g} kg",
        "log the forces exerted on the body, not by it, or reverse their signs",
    ),
    F.BASE_UNEXPLAINED: ("the model leaves {share:.0f%} of the {part} on the base '{subject}' unexplained", WRENCHES),
    F.TLS_CONFUSED: (
        "total least squares cannot separate the payload from the noise (standard deviation over "
        "<limit?{limit:g%}|50 %>)",
        "use --method ml, or a heavier payload and longer runs with less noise",
    ),
    F.ALL_NEGATIVE: (
        "all drive gains are negative",
        "check the sign of the currents and positions, gravity" + WHICH_PAYLOAD,
    ),
    F.SWAPPED: (
        "the {kind}s of {joints:and} look <count=2?swapped|permuted>: {exchanged:.2g%} is unexplained after exchanging "
        "them, {as_logged:.2g%} as logged{also}",
        "check that the position and {kind} columns are of the same joint in all runs",
    ),
    F.MAGNITUDES: (
        "the {kind}s of {joints:and} look like magnitudes: {exchanged:.2g%} is unexplained with signs that fit the "
        "motion, {as_logged:.2g%} as logged{also}",
        "log signed values (some drives store the sign in a separate bit or column)",
    ),
    F.REVERSED: (
        "the {kind}s of {joints:and} look reversed: the parameters that joints share, or the inertias of the robot "
        "file, contradict their sign{also}",
        "check the signs of the {kind} and position columns",
    ),
    F.LATE: (
        "the {kind}s were logged {lag:|.0fm} ms too <lag+?late|early>: {shifted:.2g%} is unexplained after shifting "
        "them, {as_logged:.2g%} as logged{also}",
        "log them with the time stamps of the positions, or if those of all joints are equally late, write "
        "'preparation: {{delay: {lag:.3g}}}'",
    ),
    F.FROZEN: (
        "the position of '{joint}' never changes in run '{run}', but {share:.2g%} of the {kind} of '{other}' is then "
        "unexplained<usual?, {usual:.2g%} in other runs>, so it moved",
        "check the encoder and the position column of '{joint}' in that run, and log it again",
    ),
    F.REFUTED: _refuted,
    F.UNEXPLAINED: (
        "the model leaves {share:.0f%} of the joint's {kind} unexplained",
        "<given?check the position and {kind} columns, their signs and units, the clock of the log, and 'preparation'|"
        "check that the position and current columns are of the same joint in all runs, and check their signs and "
        "units>",
    ),
    F.PAYLOAD: (
        "<given?payload '{subject}', which contradicts the data, leaves this joint unexplained|"
        "the scale comes from payload '{subject}', which contradicts the data>",
        "correct the payload",
    ),
    F.SENSOR: (
        "the scale comes from the <sensor?{sensor}|torque sensor> of '{subject}', which contradicts all other data",
        SENSOR,
    ),
    F.WHOLE_MASS: ("the mass of the robot, {subject}, " + PRIOR, SCALE),
    F.UNSETTLED: (
        "the iteration did not converge, so the data do not determine it",
        "resolve the contradictory joints first",
    ),
    F.LOST: ("the relative standard deviation is {std:.0f%}", LOST),
    F.SIGN_OPEN: ("the 95 % interval includes zero", LOST),
    F.OTHER_ESTIMATOR: (
        "2SLS on the same data gives a gain {move:|.2g%} <move+?larger|smaller>, a difference of {t:|.0f} standard "
        "deviations",
        "{to_do}",
    ),
    F.PRIOR_GAIN: _prior_gain,
    F.NEGATIVE_GAIN: (
        "<negative?negative|positive> gain: positive {kind} drives the joint <negative?backwards|forwards>",
        "reverse the sign of its {kind} or position column; or if <prior?that is intended, reverse the prior gain|"
        "the drive does turn against its joint, state a negative prior gain>",
    ),
    F.GAINS_APART: (
        "its gain of {gain:.3g} {unit} and that of '{subject}', {of_peer:.3g} {unit}, differ by a factor of "
        "{ratio:.2g}, which is implausible for motors and gears of one robot",
        "check that the {kind} columns of these joints are in the same unit, and convert those that are not; if the "
        "motors do differ, state 'prior_gains'",
    ),
    F.HEAVY_PAYLOAD: (
        "payload '{subject}' weighs {mass:.4g} kg, more than arms that reach {reach:.2g} m carry (about {most:.3g} kg "
        "at most); all drive gains are proportional to it",
        "if it is in g, write 'mass: {mass:.4gk}' (kg); otherwise state 'prior_gains'",
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
    F.EFFORT: EFFORT,
    F.DOUBTFUL_LIMIT: EFFORT,
    F.IMPOSSIBLE_PARAMETERS: lambda values: (
        "physically impossible parameters: "
        + some(values["parameters"], "{0} = {1:.3g} {3} (standard deviation {2:.2g})", ", "),
        IMPOSSIBLE,
    ),
    F.WIDE_SCALE: (
        WIDE + ", limited by the uncertainty of its scale reference",
        "calibrate the sensors, or weigh the payload, more accurately",
    ),
    F.WIDE_RANDOM: (WIDE, f"<payload?{LOADED}|{UNLOADED}>"),
    F.WIDE_RIPPLE: (
        WIDE + ", because residuals repeat at the same positions (motor ripple, cables or springs)",
        "use other paths in the loaded and unloaded runs" + LONGER,
    ),
    F.WIDE_CAUSE: (WIDE + ", because the data cannot exclude {cause}", "{to_do}" + LONGER),
    F.COUPLED: (
        "joint '{subject}' contradicts the model, whose parameters all joints share",
        "resolve that joint first",
    ),
    F.DELAY_NOISE: (
        "the current's rate of change may be nothing but noise",
        "treat it as unknown, or move this joint faster; the drive gain does not depend on it",
    ),
    F.DELAY_UNCERTAIN: (
        "its standard deviation is {std:.2gm} ms",
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
    F.IMPOSSIBLE: (
        "it is negative by {t:.0f} standard deviations: <friction?friction that drives the joint|a negative inertia>",
        IMPOSSIBLE,
    ),
    F.NEGATIVE_PAYLOAD: (
        "its mass of {mass:.4g} kg (standard deviation {std:.2g}) is negative, which no body has",
        "check which runs carry it, as the others may be the loaded ones, the signs of the commands, and gravity",
    ),
    F.PAYLOAD_MASS: (
        "all other data give it a mass of {found:.4g} kg (standard deviation {std:.2g}), not {declared:.4g} kg",
        "<given?check which runs carry the payload, its mass (kg) and <given=torque?the unit and scale of the torques|"
        "the given gains>; if the mass is certain, <given=torque?leave out --method|identify the gains>: it then sets "
        "their scale|"
        "reweigh the payloads: a mass is wrong, or a run carries a payload other than declared>",
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
