"""Notes beside the gains, printed by both ``gtau identify`` and ``gtau check``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.finding import FindingKind as F
from gtau.estimation.diagnostics.sentences import note
from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.regression.friction import TEMPERATURE_TERMS
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.payload_estimate import PayloadEstimate
from gtau.estimation.results.singularity_distances import NearestPose
from gtau.estimation.thresholds.estimates import INFLATED
from gtau.estimation.thresholds.logs import NEAR_SINGULAR
from gtau.robots.parameter import parameter_of
from gtau.signals.columns import Signals
from gtau.signals.notes import Kind, Note
from gtau.signals.payload import FIRST_MOMENTS

VISIBLE = 0.01  # per cent: a smaller torque error is rounding


def findings(result: IdentifiedModel) -> list[Note]:
    """Collect all notes on a result beside its verdicts: on the fit, the motion, the logs and the robot."""
    return [*remarks(result), *near_singularities(result.singularities), *result.notes]


def remarks(result: IdentifiedModel) -> list[Note]:
    """Note faults of the fit beside the gains, with advice."""
    notes = []
    for payload in {each.name: each for each in result.payloads}.values():
        if payload.verdict.outcome != Outcome.GOOD:
            what = f"payload '{payload.name}' {payload.verdict.outcome.value}: {payload.verdict.why}"
            notes.append(_of_verdict(what, payload.verdict))
        if "m" not in payload.parameters:
            notes.append(note(Finding(F.MASS_UNSEEN, (), payload.name, {"sums": sums_with_mass(payload)})))
    for sensor in result.sensors:
        if sensor.verdict.outcome != Outcome.GOOD:
            what = f"the torque sensor of '{sensor.joint}' {sensor.verdict.outcome.value}: {sensor.verdict.why}"
            notes.append(_of_verdict(what, sensor.verdict))
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(each.relative > VISIBLE for each in result.residuals):
        notes.append(note(Finding(F.AUTOCORRELATED, values={"factor": lack})))
    absurd = [each for each in result.parameters.values() if each.verdict.outcome == Outcome.CONTRADICTORY]
    if absurd:
        listed = [(each.name, each.value, each.unit) for each in absurd]
        notes.append(note(Finding(F.IMPOSSIBLE_PARAMETERS, values={"parameters": listed})))
    return notes + not_separated([name for name, each in result.parameters.items() if each.value is None])


def sums_with_mass(payload: PayloadEstimate) -> list[str]:
    """List the identifiable sums that contain an unidentifiable payload mass, as ``my - 0.1445 m``."""
    kinds = FIRST_MOMENTS if set(FIRST_MOMENTS) & set(payload.parameters) else tuple(payload.parameters)
    regroupings = [payload.parameters[kind].regrouping for kind in kinds if kind in payload.parameters]
    return [each.replace("+ -", "- ") for each in regroupings if each.split()[-1] == "m"]


def _of_verdict(what: str, verdict: Verdict) -> Note:
    return Note(Kind.MODEL, what, verdict.advice, finding="" if verdict.finding is None else verdict.finding.kind)


def without_temperature(result: IdentifiedModel, signals: Signals) -> list[str]:
    """Note the temperature assumed for logs without one where the model's friction depends on it."""
    warm = result.temperatures
    depends = {parameter_of(name).body for name in result.friction if parameter_of(name).kind in TEMPERATURE_TERMS}
    if warm is None or not depends or signals.temperature is not None:
        return []
    listed = ", ".join(f"'{joint}' {warm.of_joint[joint]:.4g}" for joint in sorted(depends))
    return [
        f"friction depends on the temperature, which these logs lack; the reference is assumed ({listed} "
        f"{warm.unit}); add 'temperature' to the signals"
    ]


def not_separated(names: Sequence[str]) -> list[Note]:
    """Note base parameters that the motions cannot separate from others, if there are any."""
    if not names:
        return []
    return [note(Finding(F.NOT_SEPARATED, values={"parameters": list(names)}))]


def near_singularities(nearest: Iterable[NearestPose]) -> list[Note]:
    """Note every run so close to a singularity of type 2 that modelling errors are magnified."""
    return [
        Note(
            Kind.SINGULARITY,
            f"the motion passes within {each.distance:.2g} of a type 2 singularity at {each.time:.4g} s, where errors "
            f"of position and geometry are amplified",
            "keep the motion away from that pose",
            source=each.run,
            time=each.time,
        )
        for each in nearest
        if each.type == 2 and each.distance < NEAR_SINGULAR
    ]
