"""Schemas: what requests hold and answers look like, by noun. OpenAPI is made from these."""

from __future__ import annotations

from api.schemas.common import Label, Page
from api.schemas.directions import (
    AlbedoDocument,
    EvaluationDocument,
    PdfDocument,
    SampleRequest,
    SamplesDocument,
    SliceInfoDocument,
    TableEvaluationDocument,
    TableSampleRequest,
)
from api.schemas.jobs import (
    CalibrationRequest,
    FitRequest,
    JobDocument,
    PosteriorRequest,
    Progress,
    TradeoffRequest,
)
from api.schemas.models import ExportTargetDocument, FamilyDocument, Health, ModelDocument, ModelRequest
from api.schemas.results import (
    CalibrationDocument,
    CalibrationSummary,
    FitDocument,
    FitSummary,
    PosteriorDocument,
    PosteriorSummary,
    TradeoffDocument,
    TradeoffSummary,
)
from api.schemas.scenes import (
    DifferenceDocument,
    PictureDocument,
    PlanDocument,
    PlanRequest,
    RenderRequest,
    SceneDocument,
    SceneSummary,
)
from api.schemas.tables import CheckDocument, FindingDocument, InfoDocument, TableDocument

__all__ = [
    "AlbedoDocument",
    "CalibrationDocument",
    "CalibrationRequest",
    "CalibrationSummary",
    "CheckDocument",
    "DifferenceDocument",
    "EvaluationDocument",
    "ExportTargetDocument",
    "FamilyDocument",
    "FindingDocument",
    "FitDocument",
    "FitRequest",
    "FitSummary",
    "Health",
    "InfoDocument",
    "JobDocument",
    "Label",
    "ModelDocument",
    "ModelRequest",
    "Page",
    "PdfDocument",
    "PictureDocument",
    "PlanDocument",
    "PlanRequest",
    "PosteriorDocument",
    "PosteriorRequest",
    "PosteriorSummary",
    "Progress",
    "RenderRequest",
    "SampleRequest",
    "SamplesDocument",
    "SceneDocument",
    "SceneSummary",
    "SliceInfoDocument",
    "TableDocument",
    "TableEvaluationDocument",
    "TableSampleRequest",
    "TradeoffDocument",
    "TradeoffRequest",
    "TradeoffSummary",
]
