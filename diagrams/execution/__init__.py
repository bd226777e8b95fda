"""Pushes made by the arm: plans of its motion and the block that carries them out."""

from slipmap.diagrams.execution.requests import ActivePush, ExecutionStatus

__all__ = ["ActivePush", "ExecutionStatus"]
