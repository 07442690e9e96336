"""One call of a campaign: read the folder, judge what was played, and design what to play next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtau.campaigns.candidates import Candidate, beside_the_axis, best, candidates, expected_width
from gtau.campaigns.decision import (
    BLOCKED,
    CONFIRM,
    MODEL,
    OF_MASS,
    WORTH,
    Decision,
    decide,
    identified,
    listed,
    refuse_to_go_on,
    slower,
    warming,
    write_experiment,
)
from gtau.campaigns.folder import (
    ASIDE,
    DECISION,
    DESIGN,
    PLAYED,
    SETTINGS,
    Round,
    digest,
    read_design_file,
    read_rounds,
    read_settings,
    scene,
    void,
    write_json,
)
from gtau.campaigns.next_motion import next_task, played_again
from gtau.campaigns.rehearsal import Rehearsal, rehearse, write_motion
from gtau.documents.files import folder_of
from gtau.documents.validation import FUNCTION, NUMBER, PATH, takes
from gtau.errors import GtauError
from gtau.estimation.results.model_file import save
from gtau.excitation.design import Design, excite, never
from gtau.excitation.design_file import DesignFile, make_task
from gtau.progress import Progress, silent

PLAY, MODEL_FILE = "play", "model.json"
STARTS = 2  # searches for a motion
REDUCED = 0.25  # m/s, which a dry run does not exceed


def _unstoppable() -> AbstractContextManager[Callable[[], bool]]:
    return nullcontext(never)


@dataclass(frozen=True)
class CampaignState:
    """The state of a campaign: what to do next, its rounds, and the decision after the last that was played.

    ``next`` is ``play``, ``done``, ``stopped`` or ``blocked``, and ``say`` says it in a sentence.
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
        return {
            "schema": "gtau-campaign/1",
            "next": self.next,
            "say": self.say,
            "accuracy": self.accuracy,
            "rounds": [
                {
                    "round": round_.folder.name,
                    "purpose": round_.motion["purpose"],
                    "rehearsal": round_.motion["rehearsal"],
                    "played": round_.played and {"end": round_.played.end, "speed": round_.played.speed},
                    "set_aside": round_.aside or None,
                    "decision": dict(round_.decision) if round_.decision else None,
                }
                for round_ in self.rounds
            ],
        }


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
    progress: Progress = silent,
    searching: Callable[[], Any] = _unstoppable,
) -> CampaignState:
    """Identify what was played, and decide: done, the next motion, or why another motion cannot help.

    The folder is the only state: the same call again does nothing again, and one that was interrupted is made up for.

    Parameters
    ----------
    folder : path
        Of the campaign; it holds ``design.yaml`` as of ``gtau excite``, or gets one.
    robot : path or str, optional
        Robot file or name of the catalog, of a new campaign.
    payload : float, optional
        Mass of the payload, kg, of a new campaign.
    accuracy : float, optional
        Half the 95 % interval of every gain that is wanted, per cent; 3 if it was never given.
    progress : callable, optional
        Called as the work goes on.
    searching : callable, optional
        Makes the context of each search for a motion, which yields what is asked in every iteration: whether to stop.

    Returns
    -------
    CampaignState
        What to do next, with all rounds.

    Raises
    ------
    GtauError
        If a file is wrong, or no motion is within the limits.
    """
    folder = Path(folder)
    settings = read_settings(folder, robot, payload, accuracy)
    file, rounds = read_design_file(folder), read_rounds(folder)
    used = [round_ for round_ in rounds if round_.played is not None and not round_.aside]
    waiting = rounds[-1] if rounds and rounds[-1].played is None else None
    if waiting is not None and waiting.aside:
        raise GtauError(f"{waiting.folder} was not played, so there is nothing to set aside; remove its {ASIDE}.")
    if waiting is not None and not void(waiting) and _current(folder, file, waiting, used):
        return _to_play(folder, settings.accuracy, rounds)
    if problem := next(filter(None, map(_unusable, used)), ""):
        return CampaignState(folder, settings.accuracy, BLOCKED, problem, tuple(rounds), None)
    place = folder / f"{1 + max((round_.number for round_ in rounds if round_.played is not None), default=0):02d}"
    if used:
        return _judge(place, settings.accuracy, file, used, progress, searching)
    try:
        task, _ = make_task(file)
    except GtauError as refusal:
        raise GtauError(f"{folder / DESIGN}: {refusal}") from None
    with searching() as stop:
        designed = excite(task, starts=STARTS, seed=int(place.name), progress=progress, stop=stop)
    rehearsal = rehearsed(designed, file, None, progress)
    write_motion(folder_of(place), file, *rehearsal, {"purpose": "first", "after": "", "warm_up": False})
    return _to_play(folder, settings.accuracy, read_rounds(folder))


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
    """Say why the logs of a round that was played cannot be used, empty if they can."""
    assert last.played is not None
    if last.played.hash != last.motion["hash"]:
        return f"round {last.folder} was played with another motion; play it again, or set it aside ({ASIDE})"
    if not last.complete:
        return (
            f"round {last.folder} was not played to its end ({last.played.end}); remove {PLAYED} and play it again, or "
            f"set it aside with a reason ({ASIDE})"
        )
    missing = [run["name"] for run in last.motion["runs"] if run["name"] not in {r.name for r in last.played.runs}]
    missing += [run.log for run in last.played.runs if not (last.folder / run.log).exists()]
    lacks = f"round {last.folder} lacks {', '.join(missing)}"
    return f"{lacks}; play it again, or set it aside ({ASIDE})" if missing else ""


def _inputs(folder: Path, file: DesignFile, used: list[Round]) -> dict[str, str]:
    """Hash all that a decision rests on."""
    logs = [round_.folder / run.log for round_ in used if round_.played for run in round_.played.runs]
    return digest(
        [folder / SETTINGS, *scene(folder, file), *(round_.folder / PLAYED for round_ in used), *logs], folder
    )


def _current(folder: Path, file: DesignFile, waiting: Round, used: list[Round]) -> bool:
    """Whether a motion that waits was designed after the decision that now stands."""
    if not used:
        return bool(waiting.motion["purpose"] == "first")
    decision, after = used[-1].decision, used[-1].folder.name
    return (
        decision is not None and decision["inputs"] == _inputs(folder, file, used) and waiting.motion["after"] == after
    )


def _judge(
    place: Path, accuracy: float, file: DesignFile, used: list[Round], progress: Progress, searching: Callable[[], Any]
) -> CampaignState:
    """Decide from the rounds used, and write the next motion at ``place`` before the decision that asks for it."""
    folder, last = place.parent, used[-1]
    known, inputs = last.decision, _inputs(folder, file, used)
    if known is None or known["inputs"] != inputs or known["next"] is not None:
        decision = _decided(place, accuracy, file, used, progress, searching)
        next_one = place.name if decision.goes_on else None
        write_json(
            last.folder / DECISION, {"schema": "gtau-decision/1", **vars(decision), "next": next_one, "inputs": inputs}
        )
        if decision.goes_on:
            return _to_play(folder, accuracy, read_rounds(folder))
    known = last.decision or {}
    say = f"{known['kind']}: {known['say']}"
    return CampaignState(folder, accuracy, known["kind"], say, tuple(read_rounds(folder)), known)


def _decided(
    place: Path,
    accuracy: float,
    file: DesignFile,
    used: list[Round],
    progress: Progress,
    searching: Callable[[], Any] = _unstoppable,
) -> Decision:
    """Identify, decide, and where it goes on write the next motion at ``place``."""
    last = used[-1]
    result = identified(write_experiment(last.folder / "experiment.yaml", file, used), accuracy, progress)
    if isinstance(result, Decision):
        return result
    save(result, last.folder / MODEL_FILE)
    alone = known = None
    if last.motion["purpose"] == CONFIRM and len(used) > 1:  # those before may be set aside
        alone = identified(write_experiment(last.folder / "alone.yaml", file, used[-1:]), accuracy, progress)
        known = used[-2].decision
        if known is None or not known["inputs"].items() <= _inputs(place.parent, file, used).items():
            before = identified(write_experiment(last.folder / "before.yaml", file, used[:-1]), accuracy, progress)
            known = {"gains": before.gains if isinstance(before, Decision) else listed(before)}
    decision = decide(result, accuracy, used, alone, known)
    decision = replace(decision, notes=(*decision.notes, *slower(result, used), OF_MASS))
    if not decision.goes_on:
        return decision
    model = last.folder / MODEL_FILE
    task = next_task(file, result, model)
    try:
        with searching() as stop:
            designed = excite(task, starts=STARTS, seed=int(place.name), progress=progress, stop=stop)
    except GtauError as refusal:
        designed, note = played_again(task, used, refusal, progress)
        decision = replace(decision, notes=(*decision.notes, note))
    if decision.kind != CONFIRM:
        offered = list(candidates(designed)) if decision.kind == MODEL else [Candidate("as designed", designed)]
        offered += beside_the_axis(designed, result)

        def width_of(candidate: Candidate) -> float:
            progress(f"rehearsing {candidate.label}", offered.index(candidate), len(offered))
            return expected_width(candidate, result, last.number)

        chosen, widths = best(offered, width_of)
        *usual, other = (float(entry["half_width"] or np.inf) for entry in widths)
        if any(offered[-1].beside) and other <= WORTH * min(usual):
            advice = (
                f"mount the payload off the axis of the last joint: {offered[-1].label} it would be +-{other:.3g} %"
            )
            decision = replace(decision, notes=(advice, *decision.notes))
        designed, decision = chosen.design, refuse_to_go_on(result, decision, widths, expected_width(None, result, 0))
    if decision.goes_on:
        trusted = model if task.prior.covariance is not None else None
        warm_up = warming(result, last)
        decision = replace(decision, notes=(*decision.notes, *filter(None, (warm_up,))))
        purpose = {"purpose": decision.kind, "after": last.folder.name, "warm_up": bool(warm_up)}
        write_motion(folder_of(place), file, *rehearsed(designed, file, trusted, progress), purpose)
    return decision


def rehearsed(designed: Design, file: DesignFile, model: Path | None, progress: Progress) -> tuple[Design, Rehearsal]:
    """Rehearse a motion, or where that is refused a slower one."""
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
