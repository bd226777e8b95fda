"""Diagnosis: which physical effect do the pushes show that the model does not have?"""

from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.results import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
