"""Exports: a fitted model or a measured table as files that other programs open. One file per target."""

from __future__ import annotations

from fitter.export.registry import Target, target, targets
from fitter.export.subject import Subject, subject
from fitter.export.writing import Exported, write

__all__ = ["Exported", "Subject", "Target", "subject", "target", "targets", "write"]
