"""Audits of physics engines: how they depart from Coulomb's law of friction, and by how many millimetres."""
