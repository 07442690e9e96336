"""Decisions of a campaign, by the part of the interval that limits the worst gain."""

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
from gtau.documents.markup import yaml_text
from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import APART
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.effects.estimate import CONTRADICTED
from gtau.estimation.effects.known.friction_drift import EFFECT as FRICTION_DRIFT
from gtau.estimation.effects.known.gain_drift import EFFECT as GAIN_DRIFT
from gtau.estimation.experiment_runs import options_of
from gtau.estimation.results.result import IdentifiedModel
from gtau.excitation.design_file import DesignFile
from gtau.findings import Grade, Progress, to_width
from gtau.signals.reading.logs import read_log
from gtau.uses.identify import identify

ROUNDS = 5  # after which a campaign ends
WORTH = 0.9  # share of the widest interval that a motion must reach, or the campaign ends
SHOWN = 0.05  # share of the residual variance from which an effect counts
STRETCHED = 0.9  # share of the speed below which a motion was not played as designed
# effects that a warm-up reduces: shown by none of 87 results of healthy robots in MuJoCo, and by all four with friction
# falling by 10 or 30 %
DRIFTS = {FRICTION_DRIFT.name, GAIN_DRIFT.name}
MASS_NOTE = "gains are proportional to the payload's mass: they are as exact as its weighing"
RANDOM, MODEL, CONFIRM = "random part", "model part", "confirm"
DONE, STOPPED, BLOCKED = "done", "stopped", "blocked"


@dataclass(frozen=True)
class Decision:
    """What limits the worst gain, and the consequence: another motion (``RANDOM``, ``MODEL``, ``CONFIRM``), or an end.

    ``say`` is a sentence with figures, ``gains`` are the gains of all rounds by joint, ``candidates`` are the motions
    rehearsed. ``notes`` say why, what to do, and what was not as designed; ``suspect`` is the effect the data show.
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

    def noting(self, *notes: str) -> Decision:
        """Add notes."""
        return replace(self, notes=(*self.notes, *notes))


def write_experiment(path: Path, file: DesignFile, rounds: Sequence[Round]) -> Path:
    """Write the experiment file of some rounds, with the payloads that the design file states now."""
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
    drives = {joint: drive.model_dump(exclude_unset=True) for joint, drive in file.drives.items()}
    document = {"robot": source, "signals": dict(signals), **({"drives": drives} if drives else {}), "runs": runs}
    write_atomically(path, yaml_text(document))
    return path


def identified(path: Path, accuracy: float, progress: Progress) -> IdentifiedModel | Decision:
    """Identify the rounds of an experiment file; if the result is not believable, say why and what to do."""
    try:
        result = identify(path, options=options_of(accuracy=accuracy / 100), progress=progress)
    except GtauError as refusal:
        return Decision(BLOCKED, f"no result: {str(refusal).rstrip('.')}")
    gains = result.drive_gains
    if result.believable and all(gain.verdict.outcome != Grade.CONTRADICTORY for gain in gains.values()):
        return result
    loads = [(load.name, load) for load in result.payloads]
    estimates: list[tuple[str, Any]] = [*gains.items(), *loads, *result.parameters.items()]
    name, worst = max(((name, one.verdict) for name, one in estimates), key=lambda pair: pair[1].outcome.rank)
    say = ": ".join(filter(None, (f"'{name}' is {worst.outcome.value}", worst.why)))
    return Decision(BLOCKED, say, listed(result), notes=tuple(filter(None, (worst.advice,))))


def listed(result: IdentifiedModel) -> dict[str, dict[str, Any]]:
    """List gains with the half-widths of their 95 % intervals and the standard deviations of both parts, per cent."""
    return {
        joint: {
            "value": gain.value,
            "unit": gain.unit,
            "half_width": gain.half_width,
            "random": _share(gain.random_std, gain.value),
            "model": _share(gain.model_std, gain.value),
            "verdict": gain.verdict.outcome.value,
            "why": gain.verdict.sentence,
        }
        for joint, gain in result.drive_gains.items()
    }


def _share(std: float | None, value: float | None) -> float | None:
    return None if std is None or not value else 100 * std / abs(value)


def decide(
    result: IdentifiedModel,
    accuracy: float,
    rounds: Sequence[Round],
    alone: IdentifiedModel | Decision | None,
    before: Mapping[str, Any] | None = None,
) -> Decision:
    """Decide after the last of the ``rounds``, from the result of all rounds.

    ``alone`` is the result of a confirming round by itself, and ``before`` holds the ``gains`` of the earlier rounds.
    """
    wide, gains = widths(result), listed(result)
    joint = max(wide, key=lambda name: wide[name])
    width = f"+-{wide[joint]:.3g} %"
    reached = wide[joint] <= accuracy
    within = f"all gains are known to {accuracy:g} % (the widest: '{joint}' {width})"
    if reached and alone is None:
        if len(rounds) >= ROUNDS:
            return Decision(STOPPED, f"{within}; five rounds are over, so none is left to confirm it", gains)
        return Decision(CONFIRM, f"{within}; a confirming round must agree", gains)
    if isinstance(alone, Decision):
        return replace(alone, say=f"the confirming round by itself: {alone.say}")
    if alone is not None and (apart := _apart(alone, before)):
        advice = "check payload, tool and temperature of the last round, or set a round aside"
        return Decision(BLOCKED, apart, gains, notes=(advice,))
    if reached:
        return Decision(DONE, f"{within}, and the last round agrees", gains)
    gain = result.drive_gains[joint]
    by_random = gain.value is None or not gain.model_std or (gain.random_std or 0.0) >= gain.model_std
    limited = RANDOM if by_random else MODEL
    size = f"known to {width}" if np.isfinite(wide[joint]) else "not identifiable"
    say = f"'{joint}' is {size}, the target is {accuracy:g} %; the {limited} of its interval is the larger one"
    if len(rounds) >= ROUNDS:
        return Decision(STOPPED, f"five rounds are over: {say}", gains, notes=_cause(result, joint))
    if limited == RANDOM:
        return Decision(limited, say, gains)
    why, suspect = _cause(result, joint), _suspect(result)
    previous = (rounds[-2].decision or {}).get("suspect") if len(rounds) > 1 else None
    if _stalled(rounds, wide[joint]) or (suspect is not None and suspect.subject == previous):
        return Decision(STOPPED, f"another motion does not help: {say}", gains, notes=why)
    return Decision(MODEL, say, gains, notes=why, suspect="" if suspect is None else suspect.subject)


def slower(result: IdentifiedModel, rounds: Sequence[Round]) -> tuple[str, ...]:
    """Note the rounds that a controller played slower; their logs are used as they are."""
    runs, notes = iter(result.data), []
    for round_ in rounds:
        names = [f"q_{joint['name']}" for joint in round_.motion["joints"]]
        log = read_log(round_.folder / "motion.csv", ("t", *names)).arrays()
        designed = _moving(log["t"], np.column_stack([log[name] for name in names]))
        played = (_moving(run.time, run.position) for _, run in zip(round_.runs, runs, strict=False))
        share = designed / max(played)
        if share < STRETCHED:
            notes.append(
                f"round {round_.folder.name} was played at {100 * share:.0f} % of its speed and is used as such"
            )
    return tuple(notes)


def _moving(time: np.ndarray, q: np.ndarray) -> float:
    """Compute the time, s, in which a motion (N, n) is further than a hundredth of its range from its start."""
    away = (np.abs(q - q[0]) > 0.01 * np.ptp(q, axis=0)).any(axis=1)
    return float(np.ptp(time[away])) if away.any() else 0.0


def _stalled(rounds: Sequence[Round], now: float) -> bool:
    """Whether neither of the last two rounds, both for the model part, narrowed the widest interval by a tenth.

    One may fail by chance: a five-bar in MuJoCo went from +-8 to 6, 3 and 2.5 %, another from +-14 to 8, 8 and less.
    """
    both = all(round_.motion["purpose"] == MODEL for round_ in rounds[-2:])
    decided = [round_.decision["gains"].values() for round_ in rounds[-3:-1] if round_.decision]
    halves = [[gain["half_width"] for gain in gains] for gains in decided]
    widest = [*(max(of) for of in halves if of and None not in of), now]
    return both and len(widest) == 3 and all(after > WORTH * before for before, after in pairwise(widest))


def _cause(result: IdentifiedModel, joint: str) -> tuple[str, ...]:
    """Say what may be wrong with the model for the worst gain, and what to do."""
    if (suspect := _suspect(result)) is None:
        verdict = result.drive_gains[joint].verdict
        return tuple(filter(None, (verdict.why, verdict.advice)))
    share = f"{100 * suspect.share:.0f} % of the residual variance"
    return f"the data speak for {suspect.subject} ({share})", suspect.cause.advice


def _suspect(result: IdentifiedModel, drifts: bool = False) -> EstimatedEffect | None:
    """Find the effect with the largest share that a warm-up reduces (``drifts``) or that none does; None without."""
    least = -np.inf if drifts else SHOWN
    shown = (effect for effect in result.effects if effect.likelihood > CONTRADICTED and effect.share >= least)
    alike = (effect for effect in shown if (effect.effect in DRIFTS) == drifts)
    return max(alike, key=lambda effect: effect.share, default=None)


def warming(result: IdentifiedModel, last: Round) -> str:
    """Say why the next round begins with a warm-up run; empty if it does not."""
    if (drift := _suspect(result, drifts=True)) is not None:
        return f"the data show {drift.subject}, so the next round begins with a warm-up run"
    warmed = any(run["name"] == WARM_UP for run in last.motion["runs"])
    return "the next round begins with a warm-up run, as this one did" if warmed else ""


def _apart(alone: IdentifiedModel, before: Mapping[str, Any] | None) -> str:
    """Say which gain of the confirming round differs from the earlier rounds; empty if none does."""
    if before is None:
        return ""
    for joint, gain in alone.drive_gains.items():
        value, width = (before["gains"].get(joint, {}).get(key) for key in ("value", "half_width"))
        if gain.value is None or gain.std is None or value is None or width is None:
            continue
        half = width / 100 * abs(value)
        if abs(gain.value - value) > APART * np.hypot(gain.std, half / 1.96):
            then = f"{to_width(value, half)} +- {to_width(half, half)} {gain.unit}"
            return f"the last round contradicts those before: '{joint}' is {gain} by itself, and was {then}"
    return ""


def refuse_to_go_on(result: IdentifiedModel, decision: Decision, candidates: Sequence[Mapping[str, Any]]) -> Decision:
    """End the campaign if no motion at hand narrows the widest interval by a tenth, and say what else would."""
    now = max(widths(result).values())
    decision = replace(decision, candidates=tuple(candidates))
    helpful = [c for c in candidates if c["half_width"] and c["half_width"] <= WORTH * now]
    if not np.isfinite(now) or any(c["at_hand"] for c in helpful):
        return decision
    instead = "".join(f", but {c['motion']} it would be +-{c['half_width']:.3g} %" for c in helpful)
    say = f"no motion narrows the widest interval by a tenth{instead}: {decision.say}"
    return replace(decision, kind=STOPPED, say=say)
