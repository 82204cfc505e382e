"""The scene of an event, as files of posteriors keep it."""

from __future__ import annotations

import xarray as xr

from phase_ppl.world.scene import Scene


def kept_scene(kept: xr.Dataset) -> Scene:
    """Return the scene of a dataset with its arrays as variables and the rest as attributes."""
    names = ("start", "radius", "walls", "landmark_centres")
    x0, x1, y0, y1 = (float(v) for v in kept["arena"].values)
    return Scene(
        **{name: kept[name].values for name in names},
        turning=kept.attrs["turning"],
        arena=(x0, x1, y0, y1),
        landmark_half_width=float(kept.attrs["landmark_half_width"]),
    )
