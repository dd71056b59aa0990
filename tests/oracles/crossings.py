"""Echoes of targets and clutter, one draw after the other."""


def look(rng, states, p_detect, echoes, spread, clutter_per_m2, field):
    """Return a list of (position, origin) in no particular order."""
    found = []
    for target, state in enumerate(states):
        if rng.random() < p_detect:
            for _ in range(1 + rng.poisson(echoes - 1)):
                found.append((state[:2] + spread * rng.normal(size=2), target))
    for _ in range(rng.poisson(clutter_per_m2 * field**2)):
        found.append((rng.uniform(0.0, field, 2), -1))
    return found
