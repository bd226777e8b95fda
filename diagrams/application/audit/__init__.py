"""Audits of physics engines: how they depart from Coulomb's law of friction, and by how many millimetres."""

from slipmap.diagrams.application.audit.engines import find_engine
from slipmap.diagrams.application.audit.procedure import Audit, audit, prices_beside, standard_pushes
