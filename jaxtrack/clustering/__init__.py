"""Clustering of weighted samples. `fuzzy_cmeans` has fuzzy c-means, differentiable."""

from jaxtrack.clustering.fuzzy_cmeans import CMeans, fuzzy_cmeans, memberships, update

__all__ = ["CMeans", "fuzzy_cmeans", "memberships", "update"]
