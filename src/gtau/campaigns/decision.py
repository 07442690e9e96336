"""What a campaign decides after each round, by the part of the interval that limits the worst gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from gtau.campaigns.candidates import widths
from gtau.campaigns.folder import WARM_UP, Round
from gtau.documents.files import write_atomically
from gtau.documents.yaml_document import yaml_text
from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import APART
from gtau.estimation.effects.description import CONTRADICTED
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.friction_drift import FRICTION_DRIFT
from gtau.estimation.effects.gain_drift import GAIN_DRIFT
from gtau.estimation.experiment_runs import options_of
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.excitation.design_file import DesignFile
from gtau.findings import Grade
from gtau.findings.words import to_width
from gtau.progress import Progress
from gtau.signals.reading.logs import read_log
from gtau.uses.identify import identify

ROUNDS = 5  # at which a campaign ends
WORTH = 0.9  # of the widest interval: a motion is to bring it below this part, or the campaign ends
SHOWN = 0.05  # of the residual variance: nine results of three healthy five-bars 0.00, a falling torque constant 0.41
STRETCHED = 0.9  # of its speed, below which a motion was not played as it was designed
# which a warm-up lessens: none of 87 results of healthy robots in MuJoCo shows one, all four do whose friction fell by
# 10 or 30 % with time constants of 30 to 300 s
DRIFTS = {FRICTION_DRIFT.name, GAIN_DRIFT.name}
OF_MASS = "gains are proportional to the payload's mass: they are as exact as it was weighed"  # which no motion shows
RANDOM, MODEL, CONFIRM, DONE, STOPPED, BLOCKED = "random part", "model part", "confirm", "done", "stopped", "blocked"


@dataclass(frozen=True)
class Decision:
    """What limits the worst gain, and what follows: another motion to ``RANDOM``, ``MODEL`` or ``CONFIRM``, or an end.

    ``say`` is a sentence with figures, ``gains`` the gains of all rounds by joint, ``candidates`` the motions
    rehearsed, ``notes`` say why, what to do about it, and what was not as designed, and ``suspect`` is the effect that
    the data show.
    """

    kind: str
    say: str
    gains: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    candidates: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    suspect: str = ""

    @property
    def goes_on(self) -> bool:
        """Whether another motion is to be played."""
        return self.kind in (RANDOM, MODEL, CONFIRM)


def write_experiment(path: Path, file: DesignFile, rounds: Sequence[Round]) -> Path:
    """Write the experiment file of some rounds; payloads are those that the design file states now."""
    loads = {load.name: load for load in file.payloads if load is not None}
    names = [joint["name"] for joint in rounds[0].motion["joints"]]
    signals: Mapping[str, Any] = {
        "time": "t",
        "position": {name: f"q_{name}" for name in names},
        "current": {name: f"i_{name}" for name in names},
    }
    runs = []
    for round_ in rounds:
        assert round_.played is not None
        signals = round_.played.signals or signals
        carried = {run["name"]: run["payload"] for run in round_.motion["runs"]}
        for run in round_.runs:
            load = carried.get(run.name)
            log = Path(relpath(round_.folder / run.log, path.parent)).as_posix()
            stated = {"payload": loads[load["name"]].model_dump(exclude_defaults=True)} if load else {}
            runs.append({"log": log, **stated})
    robot = Path(file.robot)
    source = relpath(robot, path.parent) if robot.is_file() else file.robot
    write_atomically(path, yaml_text({"robot": source, "signals": dict(signals), "runs": runs}))
    return path


def identified(path: Path, accuracy: float, progress: Progress) -> Result | Decision:
    """Identify the rounds of an experiment file; where no result can be believed, say why and what to do."""
    try:
        result = identify(path, options=options_of(accuracy=accuracy / 100), progress=progress)
    except GtauError as refusal:
        return Decision(BLOCKED, f"no result: {str(refusal).rstrip('.')}")
    outcomes = {gain.verdict.outcome for gain in result.drive_gains.values()}
    if result.believable and Grade.CONTRADICTORY not in outcomes:
        return result
    verdicts = [(joint, gain.verdict) for joint, gain in result.drive_gains.items()]
    verdicts += [(load.name, load.verdict) for load in result.payloads]
    verdicts += [(name, estimate.verdict) for name, estimate in result.parameters.items()]
    name, worst = max(verdicts, key=lambda pair: pair[1].outcome.rank)
    said = ": ".join(filter(None, (f"'{name}' is {worst.outcome.value}", worst.why)))
    return Decision(BLOCKED, said, listed(result), notes=(worst.advice,) if worst.advice else ())


def listed(result: Result) -> dict[str, dict[str, Any]]:
    """List gains with half their 95 % intervals and the standard deviations of both parts, per cent."""
    return {joint: _entry(gain) for joint, gain in result.drive_gains.items()}


def _entry(gain: Estimate) -> dict[str, Any]:
    parts, size = {"random": gain.random_std, "model": gain.model_std}, abs(gain.value or 0.0)
    return {
        "value": gain.value,
        "unit": gain.unit,
        "half_width": gain.half_width,
        **{key: 100 * std / size if std is not None and size else None for key, std in parts.items()},
        "verdict": gain.verdict.outcome.value,
        "why": gain.verdict.sentence,
    }


def decide(
    result: Result,
    accuracy: float,
    rounds: Sequence[Round],
    alone: Result | Decision | None,
    known: Mapping[str, Any] | None = None,
) -> Decision:
    """Decide after the last of the ``rounds``, from the result of all.

    ``alone`` is the result of a confirming round, and ``known`` has the ``gains`` of the rounds before it.
    """
    wide, gains = widths(result), listed(result)
    joint = max(wide, key=lambda name: wide[name])
    width = f"+-{wide[joint]:.3g} %"
    reached, within = wide[joint] <= accuracy, f"all gains are known to {accuracy:g} % (the widest: '{joint}' {width})"
    if reached and alone is None:
        if len(rounds) >= ROUNDS:
            return Decision(STOPPED, f"{within}; five rounds are over, so none is left to confirm it", gains)
        return Decision(CONFIRM, f"{within}; one more round must agree", gains)
    if isinstance(alone, Decision):
        return replace(alone, say=f"the confirming round by itself: {alone.say}")
    if alone is not None and (apart := _apart(alone, known)):
        advice = "check payload, tool and temperature of the last round, or set a round aside"
        return Decision(BLOCKED, apart, gains, notes=(advice,))
    if reached:
        return Decision(DONE, f"{within}, and the last round agrees", gains)
    limited = RANDOM if _random(result.drive_gains[joint]) else MODEL
    size = f"known to {width}" if np.isfinite(wide[joint]) else "not identifiable"
    said = f"'{joint}' is {size}, {accuracy:g} % is asked for; the {limited} of its interval is the larger one"
    if len(rounds) >= ROUNDS:
        return Decision(STOPPED, f"five rounds are over: {said}", gains, notes=_cause(result, joint))
    if limited == RANDOM:
        return Decision(limited, said, gains)
    why, suspect, before = _cause(result, joint), _suspect(result), rounds[-2:-1]
    previous = (before[0].decision or {}).get("suspect") if before else None
    if _stalled(rounds, wide[joint]) or (suspect is not None and suspect.subject == previous):
        return Decision(STOPPED, f"another motion does not help: {said}", gains, notes=why)
    return Decision(MODEL, said, gains, notes=why, suspect="" if suspect is None else suspect.subject)


def slower(result: Result, rounds: Sequence[Round]) -> tuple[str, ...]:
    """Note the rounds that a controller stretched; their logs are used as they were played."""
    runs, notes = iter(result.data), []
    for round_ in rounds:
        names = [f"q_{joint['name']}" for joint in round_.motion["joints"]]
        log = read_log(round_.folder / "motion.csv", ("t", *names)).arrays()
        designed = _moving(log["t"], np.column_stack([log[name] for name in names]))
        share = designed / max(_moving(run.time, run.position) for _, run in zip(round_.runs, runs, strict=False))
        if share < STRETCHED:
            notes.append(
                f"round {round_.folder.name} was played at {100 * share:.0f} % of its speed and is used as such"
            )
    return tuple(notes)


def _moving(time: np.ndarray, q: np.ndarray) -> float:
    """Find the time, s, between leaving and reaching the ends of a motion (N, n), by a hundredth of its ranges."""
    away = (np.abs(q - q[0]) > 0.01 * np.ptp(q, axis=0)).any(axis=1)
    return float(np.ptp(time[away])) if away.any() else 0.0


def _random(gain: Estimate) -> bool:
    return gain.value is None or not gain.model_std or (gain.random_std or 0.0) >= gain.model_std


def _stalled(rounds: Sequence[Round], now: float) -> bool:
    """Whether neither of the last two rounds, motions for the model part, narrowed the widest interval by a tenth.

    One may fail to by chance: of five-bars in MuJoCo one went from +-8 to 6, 3 and 2.5 %, one from +-14 to 8, 8 and on.
    """
    widths_then = [_widest(round_) for round_ in rounds[-3:-1]]
    of_model = all(round_.motion["purpose"] == MODEL for round_ in rounds[-2:])
    known = [width for width in (*widths_then, now) if width is not None]
    return of_model and len(known) == 3 and all(after > WORTH * before for before, after in pairwise(known))


def _widest(round_: Round) -> float | None:
    decision = round_.decision
    known = [gain["half_width"] for gain in decision["gains"].values()] if decision else []
    return max(known) if known and None not in known else None


def _cause(result: Result, joint: str) -> tuple[str, ...]:
    """Say what may be wrong with the model of the worst gain, and what to do about it."""
    if (suspect := _suspect(result)) is None:
        verdict = result.drive_gains[joint].verdict
        return tuple(filter(None, (verdict.why, verdict.advice)))
    share = f"{100 * suspect.share:.0f} % of the residual variance"
    return f"the data speak for {suspect.subject} ({share})", suspect.cause.advice


def _suspect(result: Result) -> EstimatedEffect | None:
    """Find the effect that the data show most clearly and no warm-up lessens, None where none is shown."""
    shown = [effect for effect in result.effects if effect.likelihood > CONTRADICTED and effect.share >= SHOWN]
    return max((effect for effect in shown if effect.effect not in DRIFTS), key=lambda one: one.share, default=None)


def warming(result: Result, last: Round) -> str:
    """Say why the next round begins with a warm-up run, empty if it needs none."""
    drifts = (effect for effect in result.effects if effect.effect in DRIFTS and effect.likelihood > CONTRADICTED)
    drift = max(drifts, key=lambda effect: effect.share, default=None)
    if drift is not None:
        return f"the data show {drift.subject}, so the next round begins with a warm-up run"
    warmed = any(run["name"] == WARM_UP for run in last.motion["runs"])
    return "the next round begins with a warm-up run, as this one did" if warmed else ""


def _apart(alone: Result, before: Mapping[str, Any] | None) -> str:
    """Say which gain of the confirming round differs from the gain of the rounds before; empty if none does."""
    if before is None:
        return ""
    for joint, gain in alone.drive_gains.items():
        known = before["gains"].get(joint, {})
        if gain.value is None or gain.std is None or known.get("value") is None or known["half_width"] is None:
            continue
        std = np.hypot(gain.std, known["half_width"] / 196 * abs(known["value"]))
        if abs(gain.value - known["value"]) > APART * std:
            half = known["half_width"] / 100 * abs(known["value"])
            then = f"{to_width(known['value'], half)} +- {to_width(half, half)} {gain.unit}"
            return f"the last round contradicts those before: '{joint}' is {gain} by itself, and was {then}"
    return ""


def refuse_to_go_on(
    result: Result, decision: Decision, candidates: Sequence[Mapping[str, Any]], usual: float
) -> Decision:
    """End the campaign where no motion at hand narrows the widest interval by a tenth, and say what else may.

    That is as it is, or as such data usually leave it (``usual``, per cent) where they happened to leave it narrower: a
    five-bar gave up at 3.12 %, as its best motion would usually lead to 3.22 %.
    """
    now = max(*widths(result).values(), usual)
    by_motion = {bool(at_hand): [c["half_width"] for c in candidates if c["at_hand"] is at_hand and c["half_width"]]
                 for at_hand in (True, False)}  # fmt: skip
    decision = replace(decision, candidates=tuple(candidates))
    if not np.isfinite(now) or min(by_motion[True], default=np.inf) <= WORTH * now:
        return decision
    heavier = [c for c in candidates if not c["at_hand"] and c["half_width"] and c["half_width"] <= WORTH * now]
    instead = "".join(f", but {c['motion']} it would be +-{c['half_width']:.3g} %" for c in heavier)
    said = f"no motion narrows the widest interval by a tenth{instead}: {decision.say}"
    return replace(decision, kind=STOPPED, say=said)
