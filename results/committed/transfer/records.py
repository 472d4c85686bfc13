"""Makes records.npz of 600 forces from five measured hammer blows: each with its own strength, time and softness (a low-pass).

`python3 records.py FOLDER`, where FOLDER has blow_1.npy ... blow_5.npy (3, 25600): time (s), force (N) and acceleration, which are
data/measurements_1.npy ... _5.npy of github.com/ladisk/pyFRF (MIT) at 55431fd.
"""

import sys

import numpy as np

rng = np.random.default_rng(35)
blows = [np.load(f"{sys.argv[1]}/blow_{i}.npy") for i in range(1, 6)]
rate = 2000  # a second; every tenth is kept
t = np.arange(2001) / rate
out = np.zeros((600, 2001))
for n in range(600):
    b = blows[n % 5]
    f = b[1] - np.median(b[1])
    dt = b[0][1] - b[0][0]
    impulse = f[:256].sum() * dt  # within 10 ms
    at = (f[:256] * b[0][:256]).sum() / f[:256].sum()
    onset, sigma, gain = rng.uniform(0.05, 0.5), rng.uniform(5e-3, 10e-3), rng.uniform(0.5, 1.5)
    # the blow is a hundred times shorter than the filter: its shape is the filter's, its noise is the record's
    smooth = impulse * np.exp(-0.5 * ((t - onset - at) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    noise = np.interp(t, b[0], f)
    noise[:40] = 0
    k = np.exp(-0.5 * (np.arange(-60, 61) / (sigma * rate)) ** 2)
    out[n] = gain * (smooth + np.convolve(noise, k / k.sum(), "same"))
np.savez("records.npz", force=out[:, ::10])
