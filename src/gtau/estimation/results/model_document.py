"""A result as a JSON document, with a schema version."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from gtau.estimation.diagnostics.geometry_findings import to_document as geometry_document
from gtau.estimation.diagnostics.verdict import Verdict
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.results.estimate import Estimate, TorqueError
from gtau.estimation.results.payload import PayloadEstimate
from gtau.estimation.results.result import Result
from gtau.findings.finding import finding_document, note_document
from gtau.robots.parameter import parameter_of, unit_of
from gtau.robots.readers.native_text import native_text
from gtau.robots.robot import Robot

SCHEMA = "gtau-model/4"
OLDER = ("gtau-model/2", "gtau-model/3")
"""Schemas that are read too: 2 is without friction on all samples, and 3 has it apart from ``parameters``."""


def to_document(result: Result) -> dict[str, Any]:
    """Describe a result as a JSON document; ``rel_std`` in per cent, null where a value is known."""
    preparation = result.preparation
    return {
        "schema": SCHEMA,
        "robot": result.robot.name,
        "method": result.method,
        "kind": result.kind,
        "runs": list(result.runs),
        "drive_gains": [_estimate(each, "joint") | {"scale": dict(each.scale)} for each in result.drive_gains.values()],
        "delays": [_estimate(each, "joint") for each in result.delays.values()],
        "parameters": [
            _estimate(each) | {"regrouping": each.regrouping, "spread": each.spread, "essential": each.essential}
            for each in result.parameters.values()
        ],
        "friction": [_estimate(each) for each in result.friction.values()],
        "equation_friction": [_estimate(each) for each in result.equation_friction.values()],
        "curves": [
            {
                "joint": each.joint,
                "evidence": dict(each.evidence),
                "error": each.error,
                "plain_error": each.plain_error,
            }
            for each in result.curves.values()
        ],
        "sensors": [
            {
                "joint": each.joint,
                "kind": each.kind.name,
                "parameters": [_estimate(estimate) for estimate in each.parameters.values()],
                "delay": _estimate(each.delay, "joint"),
                "residual": torque_error(each.residual),
                "ratio": None if each.ratio is None else _estimate(each.ratio, "joint"),
            }
            for each in result.sensors
        ],
        "payloads": payload_documents(result.payloads),
        "residuals": [torque_error(each) for each in result.residuals],
        "preparation": {
            "bandwidth": preparation.bandwidth,
            "cutoff": preparation.cutoff,
            "decimation": preparation.decimator.factor,
            "decimator": preparation.decimator.kind,
            "speed_fraction": preparation.speed_fraction,
            "rate": preparation.rate,
            "given": list(preparation.given),
            "prediction_cutoffs": list(preparation.prediction_cutoffs),
            "position_noise": list(preparation.position_noise),
        },
        "logged_speeds": dict(result.logged_speeds),
        "statistics": dict(result.statistics),
        "requirements": [asdict(each) | {"met": each.met} for each in result.requirements],
        "alternatives": [
            asdict(each) | {"subject": each.subject, "causes": list(map(finding_document, each.causes))}
            for each in result.alternatives
        ],
        "singularities": [asdict(each) for each in result.singularities],
        "temperatures": result.temperatures and asdict(result.temperatures),
        "geometry": result.geometry and geometry_document(result.geometry),
        "audit": result.audit
        and asdict(result.audit)
        | {"stated_error": result.audit.stated_error, "identified_error": result.audit.identified_error},
        "notes": [note_document(note) for note in result.notes],
        "covariance": {"names": list(result.covariance_names), "matrix": result.covariance.tolist()},
        "robot_file": native_text(result.robot),
        "stated_inertias": dict(result.robot.inertias),
        "standard": None if result.consistency is None else _standard(result.consistency, result.robot),
    }


def torque_error(error: TorqueError) -> dict[str, Any]:
    """Describe a torque error as a JSON document: ``relative`` in per cent."""
    shares = {name: getattr(error, name) for name in ("relative", "relative_all", "relative_raw")}
    return asdict(error) | shares


def _standard(found: Consistency, robot: Robot) -> dict[str, Any]:
    return {
        "parameters": [
            {
                "name": name,
                "value": value,
                "unit": unit_of(parameter_of(name).kind, robot, parameter_of(name).body),
                "open": name in found.open,
            }
            for name, value in found.standard.items()
        ],
        "payloads": [{"name": name, "parameters": dict(values)} for name, values in found.payloads.items()],
        "drive_gains": [{"joint": joint, "value": g, "std": std} for joint, (g, std) in found.gains.items()],
        "moves": [asdict(move) for move in found.moves],
        "smallest_eigenvalues": dict(found.eigenvalues),
        "loss": dict(found.loss),
    }


def payload_documents(payloads: tuple[PayloadEstimate, ...]) -> list[dict[str, Any]]:
    """Describe payloads as in ``model.json`` and in what ``gtau payload --json`` prints."""
    return [
        {
            "name": each.name,
            "run": each.run,
            **_verdict(each.verdict),
            "parameters": {
                kind: _estimate(estimate) | {"known": kind in each.known, "regrouping": estimate.regrouping}
                for kind, estimate in each.parameters.items()
            },
        }
        for each in payloads
    ]


def _estimate(estimate: Estimate, key: str = "name") -> dict[str, Any]:
    return {
        key: estimate.name,
        "value": estimate.value,
        "std": estimate.std,
        "rel_std": estimate.rel_std,
        "interval": estimate.interval(),
        "freedom": None if estimate.std is None else estimate.freedom,
        "model_std": estimate.model_std,
        "unit": estimate.unit,
        **_verdict(estimate.verdict),
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    finding = None if verdict.finding is None else finding_document(verdict.finding)
    return {"outcome": verdict.outcome.value, "finding": finding, "why": verdict.why, "advice": verdict.advice}
