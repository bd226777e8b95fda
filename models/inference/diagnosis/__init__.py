"""Diagnosis: which physical effect do the pushes show that the model lacks?"""
