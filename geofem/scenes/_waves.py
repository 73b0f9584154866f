"""Period and damping of a record that swings about zero."""

from __future__ import annotations

import math

import numpy as np

from geofem.scene import Array


def crossings(t: Array, v: Array) -> Array:
    """The times at which v(t) changes sign, interpolated linearly."""
    k = np.flatnonzero(v[:-1] * v[1:] < 0)
    return t[k] - v[k] * (t[k + 1] - t[k]) / (v[k + 1] - v[k])


def period(t: Array, v: Array) -> float:
    """Twice the mean distance of the zero crossings (s); nan for fewer than two."""
    zeros = crossings(t, v)
    return float(2 * np.diff(zeros).mean()) if len(zeros) > 1 else math.nan


def decay(t: Array, v: Array) -> float:
    """The rate (1/s) at which the logarithm of the amplitude falls, by least squares over the peaks; nan for fewer than two.

    A peak is that of the parabola through the largest sample between two zeros and its neighbours.
    """
    zeros = crossings(t, v)
    times, peaks = [], []
    for a, b in zip(zeros, zeros[1:]):
        between = np.flatnonzero((a < t) & (t < b))
        if len(between) < 3:
            continue
        i = between[0] + int(np.abs(v[between]).argmax())
        shape = np.polyfit(t[i - 1 : i + 2] - t[i], np.abs(v[i - 1 : i + 2]), 2)
        times.append(t[i] - 0.5 * shape[1] / shape[0])
        peaks.append(shape[2] - 0.25 * shape[1] ** 2 / shape[0])
    if len(times) < 2:
        return math.nan
    return -float(np.polyfit(times, np.log(peaks), 1)[0])


def strongest(t: Array, v: Array, low: float, high: float) -> float:
    """The frequency (Hz) between two at which v(t) less its mean is strongest, by its Fourier integral under a Hann window."""
    weight = np.sin(np.pi * (t - t[0]) / (t[-1] - t[0])) ** 2 * np.gradient(t)
    swing = v - weight @ v / weight.sum()
    f = np.linspace(low, high, 2001)
    return float(f[np.abs(np.exp(-2j * np.pi * np.outer(f, t)) @ (weight * swing)).argmax()])
