"""One call of a campaign: read the folder, evaluate the rounds played, and design the next motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.campaigns import decision as decisions, folder as files
from gtau.campaigns.candidates import (
    Candidate,
    beside_the_axis,
    candidates,
    expected_width,
    next_task,
    played_again,
    widths,
)
from gtau.campaigns.decision import Decision, decide, identified, listed
from gtau.campaigns.folder import DESIGN, PLAYED, Round, read_design_file, read_rounds, read_settings
from gtau.campaigns.rehearsal import Rehearsal, rehearse, write_motion
from gtau.documents.validation import FUNCTION, NUMBER, PATH, takes
from gtau.errors import GtauError
from gtau.estimation.results.model_file import load, save
from gtau.estimation.results.result import IdentifiedModel
from gtau.excitation.design import Design, excite
from gtau.excitation.design_file import DesignFile, make_task
from gtau.findings import Progress, silent

PLAY, MODEL_FILE = "play", "model.json"
REDUCED = 0.25  # m/s, largest speed of the tool in a dry run


@dataclass(frozen=True)
class CampaignState:
    """The state of a campaign: the next step, all rounds, and the decision after the last round played.

    ``next`` is ``play``, ``done``, ``stopped`` or ``blocked``; ``say`` is a sentence on it.
    """

    folder: Path
    accuracy: float
    next: str
    say: str
    rounds: tuple[Round, ...]
    decision: Mapping[str, Any] | None

    @property
    def document(self) -> dict[str, Any]:
        """The state as a JSON document."""
        rounds = [
            {
                "round": round_.folder.name,
                "purpose": round_.motion["purpose"],
                "rehearsal": round_.motion["rehearsal"],
                "played": round_.played and {"end": round_.played.end, "speed": round_.played.speed},
                "set_aside": round_.aside or None,
                "decision": dict(round_.decision) if round_.decision else None,
            }
            for round_ in self.rounds
        ]
        aim = {"next": self.next, "say": self.say, "accuracy": self.accuracy}
        return {"schema": "gtau-campaign/1", **aim, "rounds": rounds}


@takes(
    folder=PATH,
    robot=("the name or path of a robot", (str, Path)),
    payload=NUMBER,
    accuracy=NUMBER,
    progress=FUNCTION,
    searching=FUNCTION,
)
def campaign(
    folder: str | Path,
    robot: str | Path | None = None,
    payload: float | None = None,
    accuracy: float | None = None,
    progress: Progress | None = None,
    searching: Callable[[], Any] | None = None,
) -> CampaignState:
    """Identify from the rounds played, and decide: done, the next motion, or why another motion cannot help.

    The folder is the only state: repeating a call is a no-op, and an interrupted call is resumed.

    Parameters
    ----------
    folder : path
        Campaign folder; ``design.yaml``, a design file of ``gtau excite``, is created if missing.
    robot : path or str, optional
        Robot file or name in the catalog, for a new campaign.
    payload : float, optional
        Mass of the payload, kg, for a new campaign.
    accuracy : float, optional
        Required half-width of every gain's 95 % interval, per cent; 3 by default.
    progress : callable, optional
        Called as the work proceeds.
    searching : callable, optional
        Returns a context manager for a search, whose value is called in every iteration and returns whether to stop.

    Returns
    -------
    CampaignState
        The next step, and all rounds.

    Raises
    ------
    GtauError
        If a file is wrong, or no motion is within the limits.

    Examples
    --------
    >>> gtau.campaign("camp", robot="five-bar", payload=1.2).next
    'play'
    """
    folder, progress, searching = Path(folder), progress or silent, searching or nullcontext
    aim = read_settings(folder, robot, payload, accuracy).accuracy
    file, rounds = read_design_file(folder), read_rounds(folder)
    used = [round_ for round_ in rounds if round_.played is not None and not round_.aside]
    pending = rounds[-1] if rounds and rounds[-1].played is None else None
    if pending is not None and pending.aside:
        raise GtauError(f"{pending.folder} was not played, so there is nothing to set aside; remove its {files.ASIDE}.")
    if pending is not None and not files.void(pending) and _current(folder, file, pending, used):
        return _to_play(folder, aim, rounds)
    if problem := next(filter(None, map(_unusable, used)), ""):
        return CampaignState(folder, aim, decisions.BLOCKED, problem, tuple(rounds), None)
    last = max((round_.number for round_ in rounds if round_.played is not None), default=0)
    place = folder / f"{last + 1:02d}"
    if used:
        return _judge(place, aim, file, used, progress, searching)
    try:
        task, _ = make_task(file)
    except GtauError as refusal:
        raise GtauError(f"{folder / DESIGN}: {refusal}") from None
    with searching() as stop:
        designed = excite(task, seed=last + 1, progress=progress, stop=stop)
    purpose = {"purpose": "first", "after": "", "warm_up": False}
    write_motion(place, file, *rehearsed(designed, file, None, progress), purpose)
    return _to_play(folder, aim, read_rounds(folder))


def _to_play(folder: Path, accuracy: float, rounds: list[Round]) -> CampaignState:
    last = rounds[-1]
    before = [round_.decision for round_ in rounds[:-1] if round_.decision and not round_.aside]
    speed = last.motion["rehearsal"]["speed"]
    part = min(0.1, np.floor(100 * REDUCED / max(speed, REDUCED)) / 100)
    say = (
        f"play {last.folder}: first with --speed {part:g} (tool up to {part * speed:.2g} m/s), then in full "
        f"({speed:.2g} m/s; ISO 10218-2 calls {REDUCED:g} m/s reduced speed)"
    )
    return CampaignState(folder, accuracy, PLAY, say, tuple(rounds), before[-1] if before else None)


def _unusable(last: Round) -> str:
    """Say why the logs of a round cannot be used; empty if they can."""
    assert last.played is not None
    if last.played.hash != last.motion["hash"]:
        return f"round {last.folder} was played with another motion; play it again, or set it aside ({files.ASIDE})"
    if last.played.end != "completed":
        return (
            f"round {last.folder} was not played to its end ({last.played.end}); remove {PLAYED} and play it again, or "
            f"set it aside with a reason ({files.ASIDE})"
        )
    names = {run.name for run in last.played.runs}
    missing = [run["name"] for run in last.motion["runs"] if run["name"] not in names]
    missing += [run.log for run in last.played.runs if not (last.folder / run.log).exists()]
    if not missing:
        return ""
    return f"round {last.folder} lacks {', '.join(missing)}; play it again, or set it aside ({files.ASIDE})"


def _inputs(folder: Path, file: DesignFile, used: list[Round]) -> dict[str, str]:
    """Hash all files on which a decision depends."""
    logs = [round_.folder / run.log for round_ in used if round_.played for run in round_.played.runs]
    played = [round_.folder / PLAYED for round_ in used]
    return files.digest([folder / files.SETTINGS, *files.scene(folder, file), *played, *logs], folder)


def _current(folder: Path, file: DesignFile, pending: Round, used: list[Round]) -> bool:
    """Whether the pending motion follows from the current decision."""
    if not used:
        return bool(pending.motion["purpose"] == "first")
    last, decision = used[-1].folder.name, used[-1].decision
    current = decision is not None and decision["inputs"] == _inputs(folder, file, used)
    return current and pending.motion["after"] == last


def _judge(
    place: Path, accuracy: float, file: DesignFile, used: list[Round], progress: Progress, searching: Callable[[], Any]
) -> CampaignState:
    """Decide from the rounds used, and write the next motion at ``place`` before the decision on it."""
    folder, last = place.parent, used[-1]
    stored, inputs = last.decision, _inputs(folder, file, used)
    if stored is None or stored["inputs"] != inputs or stored["next"] is not None:
        decision = _decided(place, accuracy, file, used, progress, searching)
        following = {"next": place.name if decision.goes_on else None, "inputs": inputs}
        files.write_json(last.folder / files.DECISION, {"schema": "gtau-decision/1", **vars(decision), **following})
        if decision.goes_on:
            return _to_play(folder, accuracy, read_rounds(folder))
        stored = last.decision or {}
    say = f"{stored['kind']}: {stored['say']}"
    return CampaignState(folder, accuracy, stored["kind"], say, tuple(read_rounds(folder)), stored)


def _decided(
    place: Path, accuracy: float, file: DesignFile, used: list[Round], progress: Progress, searching: Callable[[], Any]
) -> Decision:
    """Identify and decide, and write the next motion at ``place`` if the campaign goes on."""
    last = used[-1]
    together = identified(decisions.write_experiment(last.folder / "experiment.yaml", file, used), accuracy, progress)
    if isinstance(together, Decision):
        return together
    model, notes = last.folder / MODEL_FILE, decisions.slower(together, used)
    confirming = _confirmation(place.parent, accuracy, file, used, progress)
    result = _narrower(together, used, _inputs(place.parent, file, used))
    if result is not together:
        name = last.folder.name
        notes += (f"round {name} widens the widest interval, so gains and model come from the rounds before it",)
    save(result, model)
    decision = decide(result, accuracy, used, *confirming).noting(*notes, decisions.MASS_NOTE)
    if not decision.goes_on:
        return decision
    task = next_task(file, result, model)
    try:
        with searching() as stop:
            designed = excite(task, seed=int(place.name), progress=progress, stop=stop)
    except GtauError as refusal:
        designed, note = played_again(task, used, refusal, progress)
        decision = decision.noting(note)
    if decision.kind != decisions.CONFIRM:
        designed, decision = _best_candidate(designed, decision, result, progress)
    if decision.goes_on:
        trusted = model if task.prior.covariance is not None else None
        warm_up = decisions.warming(together, last)
        decision = decision.noting(*filter(None, (warm_up,)))
        purpose = {"purpose": decision.kind, "after": last.folder.name, "warm_up": bool(warm_up)}
        write_motion(place, file, *rehearsed(designed, file, trusted, progress), purpose)
    return decision


def _narrower(together: IdentifiedModel, used: list[Round], inputs: dict[str, str]) -> IdentifiedModel:
    """Choose the result with the narrower widest interval: of all rounds ``together``, or of those before the last one.

    A motion that shows what the model lacks would otherwise widen intervals that another motion narrowed.
    """
    stored = used[-2].decision if len(used) > 1 else None
    if not stored or stored["kind"] == decisions.BLOCKED or not stored["inputs"].items() <= inputs.items():
        return together
    before = load(used[-2].folder / MODEL_FILE).replaced(data=together.data)  # which model.json does not hold
    return min(together, before, key=lambda result: max(widths(result).values()))


def _confirmation(
    folder: Path, accuracy: float, file: DesignFile, used: list[Round], progress: Progress
) -> tuple[IdentifiedModel | Decision | None, Mapping[str, Any] | None]:
    """Identify a confirming round by itself, and return it with the decision or gains of the rounds before it."""
    last = used[-1]
    if last.motion["purpose"] != decisions.CONFIRM or len(used) == 1:  # earlier rounds may be set aside
        return None, None
    alone = identified(decisions.write_experiment(last.folder / "alone.yaml", file, used[-1:]), accuracy, progress)
    stored = used[-2].decision
    if stored is not None and stored["inputs"].items() <= _inputs(folder, file, used).items():
        return alone, stored
    before = identified(decisions.write_experiment(last.folder / "before.yaml", file, used[:-1]), accuracy, progress)
    return alone, {"gains": before.gains if isinstance(before, Decision) else listed(before)}


def _best_candidate(
    designed: Design, decision: Decision, result: IdentifiedModel, progress: Progress
) -> tuple[Design, Decision]:
    """Simulate candidates for the next motion; return the best one, and the decision with what they would reach."""
    offered = list(candidates(designed)) if decision.kind == decisions.MODEL else [Candidate("as designed", designed)]
    offered += beside_the_axis(designed, result)
    expected, listed = [], []
    for k, candidate in enumerate(offered):
        progress(f"rehearsing {candidate.label}", k, len(offered))
        width = expected_width(candidate, result, designed.task.prior.drives)
        half_width = width if np.isfinite(width) else None
        listed.append({"motion": candidate.label, "half_width": half_width, "at_hand": candidate.at_hand})
        expected.append(width)
    chosen = offered[min((k for k, candidate in enumerate(offered) if candidate.at_hand), key=lambda k: expected[k])]
    *usual, beside = expected
    if any(offered[-1].beside) and beside <= decisions.WORTH * min(usual):
        advice = f"mount the payload off the axis of the last joint: {offered[-1].label} it would be +-{beside:.3g} %"
        decision = replace(decision, notes=(advice, *decision.notes))
    return chosen.design, decisions.refuse_to_go_on(result, decision, listed)


def rehearsed(designed: Design, file: DesignFile, model: Path | None, progress: Progress) -> tuple[Design, Rehearsal]:
    """Rehearse a motion, or a slower motion if the rehearsal refuses it."""
    refusals: list[GtauError] = []
    for candidate in candidates(designed):
        try:
            if candidate.at_hand:
                rehearsal = rehearse(candidate.design, file, model, progress)
                slowed = (f"rehearsal: {candidate.label}, as otherwise {refusals[0]}",) if refusals else ()
                return candidate.design, replace(rehearsal, notes=(*rehearsal.notes, *slowed))
        except GtauError as refusal:
            refusals.append(refusal)
    raise refusals[0]
