"""Sentences for findings of reading, checking and preparing logs."""

from __future__ import annotations

from collections.abc import Mapping

from gtau.findings.kind import FindingKind as F
from gtau.findings.words import Sentence, Values, Words


def _outliers(values: Values) -> Sentence:
    counts, at = dict(values["counts"]), f"at {values['time']:.9g} s ({values['place']})"
    total = sum(counts.values())
    if total == 1:
        what = f"interpolated 1 position of joint '{values['first']}' that is an outlier: {at} it is"
    elif len(counts) == 1:
        what = f"interpolated {total} positions of joint '{values['first']}' that are outliers: the first, {at}, is"
    else:
        listed = ", ".join(f"'{joint}' ({count})" for joint, count in counts.items())
        what = (
            f"interpolated {total} positions of joints {listed} that are outliers: the first, of '{values['first']}' "
            f"{at}, is"
        )
    return (
        what + " {logged:.4g} instead of {instead:.4g} (rad or m)",
        "check the encoder and its cable, and how missing values are written",
    )


def _noisy(values: Values) -> Sentence:
    listed = ", ".join(f"'{joint}' ({100 * share:.0f} %)" for joint, share in values["shares"])
    return (
        f"position noise contributes much of the rms speed of joint{'s' * (len(values['shares']) > 1)} {listed}: "
        "inertias are underestimated",
        "move faster, or use --method iv or didim",
    )


LOG_WORDS: Mapping[str, Words] = {
    F.SKIPPED_LINES: (
        "skipped line<last?s {first} to {last}| {first}> before the table<header?, took the names of its columns from "
        "line {header}>",
        "",
    ),
    F.OTHER_ROWS: ("left out {count} row<count=1?|s> that hold only other signals", ""),
    F.BAD_ROWS: ("dropped {count} row<count=1?|s> with missing or non-numeric values ({places})", ""),
    F.REPEATED_ROWS: ("dropped {count} repeated row<count=1?|s> ({places})", ""),
    F.ALIGNED: (
        "aligned the {signal} with the positions by linear interpolation between their stamps ({rate:.4g} Hz; "
        "positions {position_rate:.4g} Hz; typically {apart:.2g} ms from a position to the nearest)<left_out?; left "
        "out {left_out} positions before the first or after the last of them>",
        "",
    ),
    F.STILL: ("the position of joint {joints:,} never changes: it yields no rows", ""),
    F.UNWRAPPED: ("unwrapped the angle of joint {joints:,}, which jumped by a turn", ""),
    F.OUTLIERS: _outliers,
    F.CLIPPED: (
        "the {signal} of joint '{joint}' is clipped at {level:.4g}: masked {samples} sample<samples=1?|s>",
        "log again with smaller accelerations, or a higher limit of the drive",
    ),
    F.MISSING: (
        "interpolated {count} missing sample<count=1?|s><masked?, and masked {masked} of them in gaps of more than "
        "{bridged} samples>",
        "log every cycle of the controller",
    ),
    F.HELD: (
        "the {signal} are held: updated at about {rate:.4g} Hz, every {period} samples; interpolated between updates",
        "log the {signal} at the rate at which they change",
    ),
    F.STALE: (
        "{stale} samples of the {signal} are stale (repeat the previous one): interpolated",
        "log in the controller's own cycle",
    ),
    F.IRREGULAR: (
        "resampled from irregular steps of {shortest:.3g} to {longest:.3g} ms to a uniform {hertz:.2f} Hz: <given?as "
        "preparation.clock says|the time stamps are used, because a regular clock makes the positions no smoother>",
        "",
    ),
    F.LATE_STAMPS: (
        "time stamps <packets?come in packets|scatter>, up to {late:.3g} ms late: the samples were taken at a regular "
        "{hertz:.2f} Hz instead, <given?as preparation.clock says|<packets?as packets are|which makes the positions "
        "smoother>>",
        "<packets?if this rate is wrong, give the right one (time: {{rate: HZ}})>",
    ),
    F.MOVED_COMMANDS: ("moved the commands {delay:.4g} ms forward, as preparation.delay says", ""),
    F.REST: ("joint '{joint}' hardly moves: its rows are left out", ""),
    F.NOISY: _noisy,
    F.RATE: (
        "the bandwidth of the motion, {bandwidth:.3g} Hz, is close to the Nyquist frequency, {nyquist:.4g} Hz: speeds "
        "and accelerations are inaccurate",
        "log at {wanted:.0f} Hz or more, or move more slowly",
    ),
    F.LIMITS: (
        "joint '{joint}' goes from {low:.4g} to {high:.4g} {unit}, outside its limits {lower:.4g} to {upper:.4g} "
        "{unit}",
        "check the zero of its position, or {limits}",
    ),
    F.SPEED_LIMIT: (
        "joint '{joint}' moves at {speed:.4g} {unit}/s (rms), {ratio:.3g} times its limit of {limit:.4g} {unit}/s",
        "check columns and units; if the limit is a placeholder, {limits}",
    ),
    F.DATA_SHEET: (
        "{quantity} of '{joint}': {value:.4g} {unit} was identified, and {stated:.4g} {unit} is by the data sheet "
        "(standard deviation {std:.2g}; apart by {apart:.1f} standard deviations)",
        "",
    ),
    F.SINGULARITY: (
        "the motion passes within {distance:.2g} of a type 2 singularity at {time:.4g} s, where errors of position and "
        "geometry are amplified",
        "keep the motion away from that pose",
    ),
    F.CONFIRMED_GEOMETRY: ("the logged pose of '{subject}' confirms the robot's geometry to {before} rms", ""),
    F.UNEXPLAINED_POSE: (
        "the logged pose of '{subject}' is {before} rms from the one computed from the positions, which lengths and "
        "encoder zeros do not explain<changes?; {changes:&} would explain {share} of its variance>",
        "check its columns, units and sequence of angles, whether it is of this body (source: tool) and in the robot's "
        "base (source: tracker), and the angles of the robot's geometry",
    ),
    F.GEOMETRY: (
        "the geometry is off: {changes:&} <count=1?explains|explain> {share} of the residual variance of the logged "
        "pose of '{subject}', which is {before} rms from the one computed, and {after} with <count=1?that change|these "
        "changes>",
        "{correct:&}",
    ),
    F.UNKNOWN_PAYLOAD: (
        "payload '{subject}' is not a payload of the model (<known?{known:,}|it has none>), so it is treated as a "
        "point mass of {mass:.4g} kg at the origin of '{tool}'",
        "correct the name, or give its 'parameters'",
    ),
    F.ASSUMED_TEMPERATURE: lambda values: (
        "friction depends on the temperature, which these logs lack; the reference is assumed ("
        + ", ".join(f"'{joint}' {value:.4g}" for joint, value in values["assumed"])
        + " {unit})",
        "add 'temperature' to the signals",
    ),
    F.ROWS: (
        "joint '{joint}' has {rows} usable rows in all runs together, away from its reversals and gaps",
        "add runs in which it moves, or longer ones",
    ),
    F.WEIGHING: (
        "no payload has a known mass, so these logs cannot give the drive gains; they can weigh '{subject}'",
        "run 'gtau payload MODEL.json' with them",
    ),
}
