"""Differentiable, batched estimators for tracking many targets in sonar and radar data."""
