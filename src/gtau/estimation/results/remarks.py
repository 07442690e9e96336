"""What is not good beside the gains, as notes that both ``gtau identify`` and ``gtau check`` print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.regression.friction import TEMPERATURE_TERMS
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.singularity_distances import NearestPose
from gtau.estimation.thresholds.estimates import INFLATED
from gtau.estimation.thresholds.logs import NEAR_SINGULAR
from gtau.signals.columns import Signals
from gtau.signals.notes import Kind, Note

VISIBLE = 0.01  # per cent: a smaller torque error is rounding
LISTED = 3


def findings(result: IdentifiedModel) -> list[Note]:
    """Collect all notes on a result beside its verdicts: on the fit, the motion, the logs and the robot."""
    return [*remarks(result), *near_singularities(result.singularities), *result.notes]


def remarks(result: IdentifiedModel) -> list[Note]:
    """Note what is wrong with the fit beside the gains, and what to do about it."""
    notes = []
    for payload in {each.name: each for each in result.payloads}.values():
        if payload.verdict.outcome != Outcome.GOOD:
            what = f"payload '{payload.name}' {payload.verdict.outcome.value}: {payload.verdict.why}"
            notes.append(Note(Kind.MODEL, what, payload.verdict.advice))
    for sensor in result.sensors:
        if sensor.verdict.outcome != Outcome.GOOD:
            what = f"the torque sensor of '{sensor.joint}' {sensor.verdict.outcome.value}: {sensor.verdict.why}"
            notes.append(Note(Kind.MODEL, what, sensor.verdict.advice))
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(each.relative > VISIBLE for each in result.residuals):
        what = (
            f"residuals are autocorrelated: standard errors are {lack:.1f} times those of white noise, so the model "
            "lacks something, such as friction of another kind, ripple of the motors, cables or elasticity"
        )
        notes.append(Note(Kind.MODEL, what))
    absurd = [each for each in result.parameters.values() if each.verdict.outcome == Outcome.CONTRADICTORY]
    if absurd:
        listed = ", ".join(f"{each.name} = {each.value:.3g} {each.unit}" for each in absurd[:LISTED])
        more = f" and {len(absurd) - LISTED} more" if len(absurd) > LISTED else ""
        notes.append(Note(Kind.MODEL, f"physically impossible parameters: {listed}{more}", absurd[0].verdict.advice))
    return notes + not_separated([name for name, each in result.parameters.items() if each.value is None])


def without_temperature(result: IdentifiedModel, signals: Signals) -> list[str]:
    """Note the temperature assumed of logs without one where the model's friction depends on it."""
    warm = result.temperatures
    depends = {name.split("_", 1)[1] for name in result.friction if name.split("_", 1)[0] in TEMPERATURE_TERMS}
    if warm is None or not depends or signals.temperature is not None:
        return []
    listed = ", ".join(f"'{joint}' {warm.of_joint[joint]:.4g}" for joint in sorted(depends))
    return [
        f"friction depends on the temperature, which these logs do not have; it is taken at the reference ({listed} "
        f"{warm.unit}); add 'temperature' to the signals"
    ]


def not_separated(names: Sequence[str]) -> list[Note]:
    """Note base parameters that the motions cannot separate from others, if there are any."""
    if not names:
        return []
    what = f"these motions cannot separate {', '.join(names)} from the other base parameters: no value is given"
    return [Note(Kind.SEPARATION, what, "add runs that move all joints in other ways")]


def near_singularities(nearest: Iterable[NearestPose]) -> list[Note]:
    """Note every run so close to a singularity of type 2 that modelling errors are magnified."""
    return [
        Note(
            Kind.SINGULARITY,
            f"the motion comes as near as {each.distance:.2g} to a singularity of type 2 at {each.time:.4g} s, where "
            "errors of position and geometry are magnified",
            "keep the motion away from that pose",
            source=each.run,
            time=each.time,
        )
        for each in nearest
        if each.type == 2 and each.distance < NEAR_SINGULAR
    ]
