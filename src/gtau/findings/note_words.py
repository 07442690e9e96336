"""Sentences for notes beside the verdicts, on data, fit and parameters, and for causes that tests of their own find."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, log10, sqrt, tau

from gtau.findings.kind import FindingKind as F
from gtau.findings.words import Sentence, Values, Words

LISTED = 3  # parameters that are named
WHICH_PAYLOAD = "<payload?, which runs carry the payload, and on which body>"
# A payload only where no wrench gives the scale, of which the payload might be a part.
UNLOADED = (
    "use longer runs, motions in which the joint lifts or accelerates more<wrenches?|, or also a payload of known mass>"
    "; check the direction of gravity"
)
SCALE = "check its value, and the units and signs of the other scale references: payloads, sensors, wrenches"
PRIOR = "is {found:.4g} from the data (standard deviation {std:.2g}), but {prior:.4g} from its prior ({prior_std:.2g})"
IMPOSSIBLE = "check the signs of positions and currents, the sampling rate, the units and 'preparation'"
FILTER = "log at a higher rate, from encoders with less noise, or set 'preparation' by hand"
INSTRUMENTS = "use --method iv or didim, or encoders with less noise"
NO_GRAVITY = (
    "log the torques of the motors (UR: 'use_currents_as_efforts: true'), or write 'robot: "
    "{{file: ..., gravity: [0, 0, 0]}}' in the experiment file for a model without gravity"
)


def some(rows: Sequence[Sequence[object]], template: str, between: str) -> str:
    """List the first rows, and say how many more there are."""
    more = f" and {len(rows) - LISTED} more" if len(rows) > LISTED else ""
    return between.join(template.format(*row) for row in rows[:LISTED]) + more


def _between_runs(values: Values) -> str:
    listed = ", ".join(f"'{joint}' ({value:+.2f})" for joint, value in values["correlations"])
    return "residuals of runs that repeat a motion with different loads are correlated at " + listed


def _command_lag(values: Values) -> Sentence:
    lag, phase = values["lag"], tau * values["bandwidth"] * values["lag"]
    size = f"by {1e3 * lag:.2g} ms (standard deviation {1e3 * values['std']:.2g} ms)"
    size = size if phase < 1 else f"by more than {1e3 * lag / phase:.2g} ms"
    return (
        f"the {{kind}}s lag behind the motion {size}, so they look low-passed, held or logged late; a low-pass filter "
        f"with that time constant attenuates them by {100 * (1 - 1 / sqrt(1 + phase**2)):.2g} % at the bandwidth of "
        "the motion, {bandwidth:.3g} Hz",
        "log the {kind}s before any filter and with the time stamps of the positions",
    )


def _without_gravity(values: Values) -> Sentence:
    joint, (before, after) = max(values["left"].items(), key=lambda left: left[1][0])
    return (
        "torques without gravity, as from a driver that compensates it, which leaves "
        f"{100 * after:.2g} % of '{joint}' unexplained instead of {100 * before:.2g} %,",
        NO_GRAVITY,
    )


def _body(body: Values) -> str:
    mass, half, run, payload = abs(body["more"]), body["half"], body["run"], body["declared"]
    decimals = min(max(1 - floor(log10(half)), 0), 4)
    size = f"{mass:.{decimals}f} kg (95 % interval {mass - half:.{decimals}f} to {mass + half:.{decimals}f} kg)"
    if payload:
        return f"{size} {'more' if body['more'] > 0 else 'less'} at the tool in run '{run}' than payload '{payload}'"
    if body["more"] < 0:
        return f"{size} less at the tool in run '{run}' than in the others"
    return f"an undeclared body of {size} at the tool in run '{run}'"


NOTE_WORDS: Mapping[str, Words] = {
    F.UNLIKE_LEGS: lambda values: (
        "legs of the same geometry differ, most in {parameter} of leg '{subject}' ("
        + ("{share:.0f%}" if values["share"] < 10 else "more than 1000 %")
        + " from the mean of the others)",
        "check that they are built identically",
    ),
    F.PRIOR: ("the known parameter {subject} " + PRIOR, SCALE),
    F.SCALE_UNTESTED: (
        "the torques are assumed to be correct, because their scale could not be tested: <why?{why}|that of no joint "
        "is identifiable ('{joint}': {cause})>",
        "add runs with a heavier payload of known mass, or longer ones",
    ),
    F.COMMON_SCALE: (
        "one factor, {scale:.3g} (standard deviation {std:.2g}), explains the torque scale of all joints; a mass of "
        "{mass:.3g} kg for payload '{subject}' (stated: {declared:.4g} kg) would explain it equally",
        "reweigh the payload before you correct the torques",
    ),
    F.NO_GRAVITY_SHOWN: (
        "the torques show no gravity ({felt:.1g%} of a joint's torque at most): a driver compensates it, or the "
        "robot is balanced",
        NO_GRAVITY,
    ),
    F.WHOLE_NUMBERS: (
        "the {kind}s are whole numbers, up to {largest:.0f}: ‰ of the rated {kind} (CiA 402, object 0x6077), "
        "mA or counts rather than SI units",
        "state their unit and the rated values (units: {{{kind}: ‰, rated: {{...}}}}), or {{{kind}: mA}}",
    ),
    F.MOTOR_SIDE: (
        "<least?the true torques are {least:.3g} to {most:.3g} times those logged|the torques reach {share:.2g%} of "
        "the limit of '{joint}' ({limit:.4g}), and less for all others>: by their size they are motor-side torques "
        "(before the gear) or currents",
        "write 'motor_torque' with the 'gear_ratio' of each joint instead of 'torque', or 'current' if they are in A, "
        "or correct the limits",
    ),
    F.MODEL_TORQUES: (
        "the {kind}s have next to no friction ({friction:.1g%} of a joint's torque at most) and {residual:.2g%} is "
        "unexplained: they come from a model in the controller, not from the motors",
        "log measured currents or torques (UR: actual_current, not target_current or target_moment)",
    ),
    F.PRIOR_INERTIA: lambda values: (
        "the inertias of '{subject}' in the robot file, used as priors with a standard deviation of {std:.0f%}, "
        "contradict the data: "
        + some(
            values["parameters"],
            "{0} is {1:.3g} {4} from the data (standard deviation {2:.2g}), {3:.3g} in the file",
            "; ",
        ),
        "give 'prior_inertias' a larger value, or correct the file",
    ),
    F.CURRENTS_APART: lambda values: (
        f"the current of joint '{{joint}}' is {values['larger'] / values['smaller']:.3g} times that of '{{subject}}' "
        "({larger:.3g} and {smaller:.3g} A rms)",
        "check that the columns are in the same unit (A, mA, % or counts), and convert those that are not",
    ),
    F.POSITION_NOISE: (
        "position noise biases {count} of {all} estimates by more than one standard deviation: {estimate} by "
        "{deviations:.1f} standard deviations (instrumental variables, which such noise does not bias, differ by "
        "{t:.0f} standard deviations of the difference); the intervals include this bias",
        INSTRUMENTS,
    ),
    F.RIPPLE: (
        "residuals repeat at the same positions ({share:.0f%} of the variance <base?of the base '{subject}'|at joint "
        "'{joint}'>): <base?a wrench is wrong or missing|motor ripple, cables or springs, which are not modelled>. "
        "They repeat in every run, so the scatter between blocks does not show them; the standard deviations include "
        "the shift of the estimates when they are modelled<move? (the gain of joint '{moved}' by {move:.3g%})>",
        "",
    ),
    F.COMMON_RESIDUALS: lambda values: (
        f"{_between_runs(values)}: the unmodelled torque there depends on the motion alone and cancels in the gains",
        "",
    ),
    F.OPPOSED_RESIDUALS: lambda values: (
        f"{_between_runs(values)}: the unmodelled torque there changes sign with the load and biases the gains; most "
        "likely {cause}",
        "{to_do}",
    ),
    F.SMALL_REFUTATION: (
        "{cause} would explain {share:.0f%} of the residual variance and move no gain by more than {move:.2g%}",
        "{to_do}",
    ),
    F.WEAK_INSTRUMENTS: (
        "two-stage least squares could not serve as a comparison: its instruments are weak for these motions "
        "(first-stage F of {strength:.2g}; {needed:.2g} is needed), so the difference would show its own bias",
        "let the joints move independently of each other, or use a heavier payload",
    ),
    F.UNTESTED: ("{cause} could not be computed for comparison: {refusal}", ""),
    F.AUTOCORRELATED: (
        "residuals are autocorrelated: standard errors are {factor:.1f} times those of white noise, so the model "
        "lacks an effect, such as another kind of friction, motor ripple, cables or elasticity",
        "",
    ),
    F.NOT_SEPARATED: (
        "these motions cannot separate {parameters} from the other base parameters: no value is given",
        "add runs with different motions of all joints",
    ),
    F.MASS_UNSEEN: (
        "the mass of payload '{subject}' is not identifiable, because <sums?only sums with its other parameters affect "
        "the joint torques: {sums}|it affects no joint torque: the body that carries it turns about a fixed point>",
        "if its centre of mass is known, write it as 'center: [x, y, z]' of the payload, m",
    ),
    F.FEW_ROWS: (
        "the tests of the model were skipped, because the robot moves too little ({rows} rows in the middle of the "
        "runs for {unknowns} unknowns): the intervals cover random errors alone",
        "log longer motions",
    ),
    F.COMMAND_LAG: _command_lag,
    F.SLIGHT_COMMAND_LAG: _command_lag,
}

CAUSE_WORDS: Mapping[str, Words] = {
    F.WITHOUT_GRAVITY: _without_gravity,
    F.LENGTH: ("a wrong length, such as the {length:.4gm} mm at {bodies:,}", "check the robot's geometry"),
    F.GAIN_CHANGE: (
        "a current of '{joint}' that is <change+?larger|smaller> in run{runs:s} {runs:and} than in the others",
        "<payload?check which runs carry the payload, its mass and the clock; otherwise let the robot warm up, and "
        "alternate loaded and unloaded runs|check the clock; otherwise let the robot warm up>: a motor's torque "
        "constant falls as it warms up",
    ),
    F.TOOL_BODY: lambda values: (
        " and ".join(map(_body, values["bodies"])),
        "check which runs carry the payload and its mass, and declare the load of every run ('payload: {{name: ..., "
        "mass: ...}}' beside its 'log')",
    ),
    F.BANDWIDTH: ("{estimate} with a bandwidth {factor:g} times as large", FILTER),
    F.SLOW_ROWS: (
        "{estimate} without rows below {fraction:.2g%} of a joint's rms speed",
        "use motions with fewer reversals, or set 'preparation' by hand",
    ),
    F.TWO_STAGE: (
        "{estimate} by two-stage least squares",
        "check <payload?the signs and the payload of every run, and gravity|signs and gravity>; if these are correct, "
        "add runs with other motions: friction that grows with the load has the same effect",
    ),
    F.INSTRUMENTS: ("{estimate} by instrumental variables", INSTRUMENTS),
}
"""Causes that are no hypotheses, as tests of their own find them."""
