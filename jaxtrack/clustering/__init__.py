"""Clustering of weighted samples, differentiable through the fixed point.

`fuzzy_cmeans` finds a given number of patterns, `isodata` their number as well; `linked` parts a
cloud of points where it has gaps. `cloud` has the cloud model, whose classes are fuzzy and random,
and C-means on it.
"""

from jaxtrack.clustering import cloud
from jaxtrack.clustering.fuzzy_cmeans import CMeans, fuzzy_cmeans, memberships, update
from jaxtrack.clustering.isodata import Isodata, IsodataSizes, farthest_first, isodata
from jaxtrack.clustering.linkage import Clusters, linked
from jaxtrack.clustering.patterns import (
    IsodataParams,
    Partition,
    delete,
    divide,
    merge,
    partition,
)
from jaxtrack.clustering.survival import survival

__all__ = [
    "CMeans",
    "Clusters",
    "Isodata",
    "IsodataParams",
    "IsodataSizes",
    "Partition",
    "cloud",
    "delete",
    "divide",
    "farthest_first",
    "fuzzy_cmeans",
    "isodata",
    "linked",
    "memberships",
    "merge",
    "partition",
    "survival",
    "update",
]
