"""Diagnosis: which physical effect do the pushes show that the model does not have?"""

from models.inference.diagnosis.procedure import diagnose
from models.inference.diagnosis.results import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
