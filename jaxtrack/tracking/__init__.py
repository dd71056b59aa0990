"""Stages wired together: from lines to tracks."""

from jaxtrack.tracking.initiate import InitiateInfo, InitiateParams, initiate

__all__ = ["InitiateInfo", "InitiateParams", "initiate"]
