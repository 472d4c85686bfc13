"""Forces and predictions in one order, and their error."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def targets(forces: ArrayLike) -> NDArray[np.float64]:
    """Converts forces (N, K, T + 1) to the shape of predictions, (N, T, K) (N): without the instant 0. ValueError unless they have three axes.

    Forces of a finer clock (`stimuli.force_samples`) must be filtered and reduced to T + 1 instants first.
    """
    values = np.asarray(forces, dtype=np.float64)
    if values.ndim != 3 or values.shape[2] < 2:
        raise ValueError(f"forces have shape {values.shape}: must be (N, K, T + 1)")
    return values[:, :, 1:].swapaxes(1, 2)


def error(forces: ArrayLike, predictions: ArrayLike) -> NDArray[np.float64]:
    """Error of each sample (%), (N): 100·Σ(f − f̂)²/Σf², over instants and panels. NaN for a sample without force.

    `predictions` have shape (N, T, K), `forces` the same or (N, K, T + 1). Trials report `numpy.nanmean` of it. ValueError if the
    shapes do not agree.
    """
    predicted, true = np.asarray(predictions, dtype=np.float64), np.asarray(forces, dtype=np.float64)
    if predicted.ndim != 3:
        raise ValueError(f"predictions have shape {predicted.shape}: must be (N, T, K)")
    samples, instants, panels = predicted.shape
    if true.shape == (samples, panels, instants + 1):
        true = targets(true)
    if true.shape != predicted.shape:
        wanted = f"(N, T, K) = {predicted.shape} or (N, K, T + 1) = {(samples, panels, instants + 1)}"
        raise ValueError(f"forces have shape {true.shape}, predictions {predicted.shape}: forces must be {wanted}")
    power = (true**2).sum(axis=(1, 2))
    rest = ((true - predicted) ** 2).sum(axis=(1, 2))
    errors: NDArray[np.float64] = np.full(samples, np.nan)
    np.divide(100.0 * rest, power, out=errors, where=power > 0.0)
    return errors
