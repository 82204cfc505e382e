"""How probable a frame is by samples of it: a kernel density whose width the samples choose.

With x_k the K sampled frames as vectors of all positions, their mean m and covariance S, the
density is a mean of normal kernels at m + a (x_k - m), a^2 = 1 / (1 + h^2), whose covariance is
S - a^2 S, so that the whole has mean m and covariance S however wide kernels are (Jones, 1991): a
simulator whose frames are normal is read without the bias of smoothing. The width h is the one,
of :data:`WIDTHS` times Silverman's for the dimensions that vary, under which the samples are most
probable, each by the others. As K grows, narrower ones win, and the density tends to the
simulator's whatever that is.

Along a direction in which samples hardly differ, kernels have a floor instead: bodies that never
move, and simulators without any noise, are compared with that standard deviation.

The error of a result comes from what it would be without each of :data:`PARTS` parts of the samples
(jackknife), mean, covariance and all.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import logsumexp

from phase_ppl.world.arrays import FloatArray

PARTS: Final = 5
"""Of the samples, each of which is left out once."""

WIDTHS: Final = (4.0, 1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Of kernels, in Silverman's; the first is close to one normal density."""

_JUDGED: Final = 32  # samples by whose densities widths are judged


def log_density(
    samples: FloatArray, at: FloatArray, scale: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return log densities of a frame by samples of it under some hypotheses.

    Args:
        samples: (hypothesis, sample, axis) positions, units.
        at: (axis,) those of the frame.
        scale: standard deviation that kernels have at least, units.
        noise: that of the observed positions, which adds to it, units.

    Returns:
        (1 + PARTS, hypothesis) with all samples, and without each part of them; and (hypothesis,)
        by how many nats the frame is less probable than on the sample that is nearest to it.
    """
    n = samples.shape[1]
    part = np.arange(n) % PARTS
    share = np.vstack([np.ones(n), *(part != one for one in range(PARTS))])
    share /= share.sum(axis=1, keepdims=True)
    shifted = samples - at  # the frame is the origin
    mean = np.einsum("pk,bkd->pbd", share, shifted)
    centred = shifted - mean[0][:, None]
    off = mean - mean[0]
    # (set, hypothesis, axis, axis)
    spread = np.array([(centred * row[:, None]).swapaxes(1, 2) @ centred for row in share])
    spread -= off[..., :, None] * off[..., None, :]
    variance, turned = np.linalg.eigh(spread)
    variance = np.maximum(variance, 0.0)
    width = _width(centred @ turned[0], variance[0], scale)
    shrunk = 1 / np.sqrt(1 + width**2)
    kernel = np.maximum((1 - shrunk**2)[:, None] * variance, scale**2) + noise**2
    from_frame = (1 - shrunk)[:, None] * mean
    away = shrunk[:, None, None] * shifted @ turned + (from_frame[..., None, :] @ turned)
    exponent = -0.5 * (away**2 / kernel[..., None, :]).sum(axis=-1)
    with np.errstate(divide="ignore"):  # of samples that are left out
        log_share = np.log(share)[:, None, :]
    found = logsumexp(exponent + log_share, axis=-1)
    return found - 0.5 * np.log(2 * np.pi * kernel).sum(axis=-1), -exponent[0].max(axis=-1)


def _width(along: FloatArray, variance: FloatArray, scale: float) -> FloatArray:
    """Return (hypothesis,) the width under which samples are most probable by the others.

    Args:
        along: (hypothesis, sample, axis) samples about their mean, along principal axes.
        variance: (hypothesis, axis) of these.
        scale: as of :func:`log_density`.
    """
    n, judged = along.shape[1], np.arange(min(along.shape[1], _JUDGED))
    n_axes = np.maximum((variance > scale**2).sum(axis=1), 1)
    usual = (4 / ((n_axes + 2) * n)) ** (1 / (n_axes + 4))
    best, found = np.full(len(along), -np.inf), usual
    for times in WIDTHS:
        shrunk = 1 / np.sqrt(1 + (times * usual) ** 2)
        kernel = np.maximum((1 - shrunk**2)[:, None] * variance, scale**2)
        # single precision is enough to choose, and takes half the time
        scaled = (along / np.sqrt(kernel)[:, None]).astype(np.float32)
        square = 0.5 * (scaled**2).sum(axis=2)
        a = shrunk.astype(np.float32)[:, None, None]
        exponent = a * (scaled[:, judged] @ scaled.swapaxes(1, 2))
        exponent -= square[:, judged, None] + a**2 * square[:, None]
        exponent[:, judged, judged] = -np.inf
        highest = exponent.max(axis=2, keepdims=True)
        near = np.log(np.exp(exponent - highest).sum(axis=2)) + highest[..., 0]
        score = near.mean(axis=1) - 0.5 * np.log(kernel).sum(axis=1)
        found = np.where(score > best, times * usual, found)
        best = np.maximum(best, score)
    return found
