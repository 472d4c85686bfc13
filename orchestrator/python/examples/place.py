"""Finds the best sensor units for a linear decoder: `python place.py SPEC [SENSORS]`.

In one simulation every free unit carries a sensor. Sensors are then added one by one: each time the sensor with which a linear decoder,
fitted to the training samples, has the least error on the test samples. Chips must have no mass, because each unit would carry one.
"""

import sys

import metasense
import numpy as np


def error(said, forces):
    true = forces[:, :, 1:].swapaxes(1, 2)
    power = (true**2).sum(axis=(1, 2))
    return 100 * (((said - true) ** 2).sum(axis=(1, 2))[power > 0] / power[power > 0]).mean()


def main(spec, sensors=3, ridge=1e-6):
    body = metasense.Body.from_spec(spec, threads=2)
    units = [unit for unit in range(body.units) if unit not in body.clamped]
    train, test = body.stimuli("train"), body.stimuli("test")
    heard = [body.simulate(body.alpha, forces, sensors=units, tape=False).signals for forces in (train, test)]
    heard = [signals.reshape(*signals.shape[:2], len(units), 3) for signals in heard]
    chosen, found = [], []
    for _ in range(sensors):
        errors = {}
        for unit in range(len(units)):
            if unit not in chosen:
                of = [signals[:, :, [*chosen, unit]].reshape(*signals.shape[:2], -1) for signals in heard]
                brain = metasense.LinearBrain((20, 20), ridge).fit(of[0], train)
                errors[unit] = error(brain.predict(of[1]), test)
        best = min(errors, key=errors.get)
        chosen.append(best)
        found.append((units[best], errors[best]))
        print(f"{len(chosen)} sensors: unit {units[best]} added, test error {errors[best]:.2f} %")
    return found


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
