"""Findings of reading a log, of checking it and of judging a fit: one record, made into sentences last."""

from __future__ import annotations

from gtau.findings.finding import Finding as Finding
from gtau.findings.kind import FindingKind as FindingKind
from gtau.findings.kind import Grade as Grade
from gtau.findings.kind import Outcome as Outcome
from gtau.findings.kind import Severity as Severity
