"""The method of moving asymptotes (MMA) for many sparse limits: K. Svanberg, SIAM J. Optim. 12 (2002) 555–573.

The steps are those of NLopt's MMA. NLopt uses a dense matrix of the limits' slopes and needs minutes per step for thousands of limits;
this module uses SciPy's sparse matrices.
"""

import numpy as np
from scipy.optimize import minimize

FLAT, LOOSE = 1e-5, 1e-6  # the least curvature; how far beyond a limit a design may lie


def nearest(slope, own, slopes, size, bounds, reach, curve, curves, weights):
    """The step that the convex models make best, what they promise there, and the weights of the limits that lead to it."""

    def step(y):
        pull, stiff = slope + slopes.T @ y, own + size.T @ y + (curve + curves @ y) / 2
        root = np.sqrt(np.maximum(stiff**2 - (pull * reach) ** 2, 0))
        d = np.clip(-pull * reach**2 / (stiff + root), -0.9 * reach, 0.9 * reach)
        b = d**2 / (reach**2 - d**2)
        a, w = d + d * b, b.sum() / 2
        return d, w, slope @ a + own @ b + curve * w, bounds + slopes @ a + size @ b + curves * w

    def dual(y):
        _, _, value, limits = step(y)
        return -(value + y @ limits), -limits

    options = {"maxiter": 3000, "maxfun": 5000, "ftol": 1e-13, "gtol": 1e-8, "maxcor": 20}
    weights = minimize(dual, weights, jac=True, bounds=[(0, None)] * weights.size, method="L-BFGS-B", options=options).x
    return step(weights), weights


def ascend(value_and_gradient, limits, start, evaluations):
    """The values met on the way to the largest within the limits, and where that is; `limits` gives what is at most 0 and its slopes."""
    x, (value, gradient), (bounds, slopes) = start, value_and_gradient(start), limits(start)
    values, reach, ends, weights = [float(value)], np.ones(x.size), [x], np.zeros(bounds.size)
    curve, curves = (np.maximum(0.1 / x.size * abs(s).sum(axis=-1), FLAT) for s in (gradient, slopes))
    while len(values) < evaluations:
        size = abs(slopes).multiply(reach).tocsr()
        found, weights = nearest(-gradient, abs(gradient) * reach, slopes, size, bounds, reach, curve, curves, weights)
        step, width, promised, within = found
        new = x + step
        (now, uphill), (beyond, steep) = value_and_gradient(new), limits(new)
        values.append(float(now))
        print(f"evaluation {len(values)}: {values[-1]:.6f}" + ", beyond limits" * bool(beyond.max() > LOOSE), flush=True)
        short, broken = value - now - promised, beyond - within
        if now > value and beyond.max() <= LOOSE:
            x, value, gradient, bounds, slopes = new, now, uphill, beyond, steep
        if short <= 0 and broken.max() <= LOOSE:
            curve, curves = max(curve / 10, FLAT), np.maximum(curves / 10, FLAT)
            ends.append(new)
            if len(ends) > 2:
                turned = (ends[-1] - ends[-2]) * (ends[-2] - ends[-3])
                reach = reach * np.where(turned < 0, 0.7, np.where(turned > 0, 1.2, 1.0))
        else:
            raised = lambda rho, by: np.where(by > 0, np.minimum(10 * rho, 1.1 * (rho + by / width)), rho)
            curve, curves = raised(curve, short), raised(curves, broken)
    return values, x
