"""From what size on loops over bodies are better code than straight lines."""

from __future__ import annotations

from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.model import Model

# Joints from which on rolled kernels are the better choice. At 7, unrolled code runs up to a third faster.
# The two are even at 10 to 15 joints where axes lie anyhow; at 18 (inverse) and 30 (forward dynamics) for
# arms with twists of 90 degrees, whose zeros only the whole graph uses to the full; at 10 for planar chains.
# But at 16 joints unrolled code takes 0.2 to 0.8 s to compile, and rolled code 0.05 to 0.1 s or, shared by
# all chains of its sort, none: that outweighs a fifth of the run time up to some ten million samples.
CROSSOVER = 16


def prefer_rolled(model: Model) -> bool:
    """Tell whether rolled kernels suit a model better than unrolled ones."""
    if model.nv < CROSSOVER or model.closures:
        return False
    from robodyn_cli.kernels.rolled.kernels import RolledPlan

    try:
        RolledPlan(model, "forward")
    except CapabilityError:
        return False  # something is symbolic: only the whole graph can tell whether it matters
    return True
