"""Findings of reading a log, of checking it and of judging a fit: one record, with its words."""

from __future__ import annotations

from gtau.findings.finding import Finding as Finding
from gtau.findings.grade import Grade as Grade
