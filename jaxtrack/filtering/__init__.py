"""Recursive filters. `rls` smooths initialised tracks."""

from jaxtrack.filtering import rls

__all__ = ["rls"]
