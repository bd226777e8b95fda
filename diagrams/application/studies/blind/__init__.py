"""Blind tests: datasets from a simulator that shares no physics with slipmap, and scores of diagnoses."""
