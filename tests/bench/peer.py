"""The work of pointsd with numpy, scipy and sqlite3, without a network: prints one JSON object.

Each throw is identified by the simplified refined instrumental variable method (Young, Recursive Estimation and
Time-Series Analysis, 2011, chapter 8) with its covariance, compared with a baseline, and stored with its samples. Two
processes identify; a third commits groups of 50 throws with synchronous FULL.

python3 peer.py TRACES SAMPLES SECONDS DATABASE: TRACES holds little-endian 32-bit floats at 1 kHz, for each throw
SAMPLES of the current [A], then SAMPLES of the position [mm].
"""

import json
import multiprocessing
import resource
import sqlite3
import sys
import time

import numpy as np
from scipy import signal

INTERVAL_S = 1e-3
RADIANS_PER_MM = 2 * np.pi / 10
MOTOR_ON_A = 0.5
GROUP = 50


def filters(a1, a0):
    """Numerators of 1, s and s^2 over s^2 + a1 s + a0, and the denominator, for inputs that are linear between samples."""
    system = ([[0, 1], [-a0, -a1]], [[0], [1]], [[1, 0], [0, 1], [-a0, -a1]], [[0], [0], [1]])
    a, b, c, d, _ = signal.cont2discrete([np.array(matrix, float) for matrix in system], INTERVAL_S, method="foh")
    return signal.ss2tf(a, b, c, d)


def identify(current, position):
    """Returns b0, a1, a0 and their covariance."""
    start = np.flatnonzero(np.abs(current) > MOTOR_ON_A)[0] - 1
    sign = np.sign(position[-1] - position[0])
    moved = sign * (position - position[:start].mean())
    end = np.flatnonzero(moved > 0.98 * moved[-1])[0]
    u, y = sign * current[start:end], moved[start:end] * RADIANS_PER_MM
    numerators, denominator = filters(10.0, 25.0)
    theta = None
    for _ in range(20):
        of_y = [signal.lfilter(numerator, denominator, y) for numerator in numerators]
        of_u = signal.lfilter(numerators[0], denominator, u)
        of_x = of_y
        if theta is not None:
            x = theta[0] * of_u
            of_x = [signal.lfilter(numerator, denominator, x) for numerator in numerators]
        regressors = np.column_stack([of_u, -of_y[1], -of_y[0]])
        instruments = np.column_stack([of_u, -of_x[1], -of_x[0]])
        before, theta = theta, np.linalg.solve(instruments.T @ regressors, instruments.T @ of_y[2])
        if before is not None and np.all(np.abs(theta - before) < 1e-6 * np.abs(theta)):
            break
        numerators, denominator = filters(theta[1], theta[2])
    residuals = of_y[2] - regressors @ theta
    return theta, residuals.var() * np.linalg.inv(instruments.T @ instruments)


def work(numbers):
    """Identifies the throws with these numbers."""
    return [(number, *identify(*TRACES[number % len(TRACES)])) for number in numbers]


def main():
    global TRACES
    traces, samples, seconds, database = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
    TRACES = np.fromfile(traces, "<f4").reshape(-1, 2, samples).astype(float)
    baseline, _ = identify(*TRACES[0])
    connection = sqlite3.connect(database, isolation_level=None)
    connection.executescript(
        "PRAGMA journal_mode = wal; PRAGMA synchronous = full;"
        "CREATE TABLE throw (throw_no INTEGER PRIMARY KEY, current BLOB, position BLOB, b0, a1, a0, covariance BLOB, is_drift);"
    )
    began, done = time.monotonic(), 0

    def groups():
        number = 0
        while time.monotonic() - began < seconds:
            yield range(number, number + GROUP)
            number += GROUP

    with multiprocessing.get_context("fork").Pool(2) as pool:
        # At most four groups wait: without this limit the queue of the pool would grow until the end.
        waiting = []
        for group in groups():
            waiting.append(pool.apply_async(work, (group,)))
            if len(waiting) > 3:
                done += store(connection, waiting.pop(0).get(), baseline)
        for group in waiting:
            done += store(connection, group.get(), baseline)
        elapsed = time.monotonic() - began
        pool.close()
        pool.join()
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    processor_s = sum(usage.ru_utime + usage.ru_stime for usage in used)
    report = {"throws_per_s": done / elapsed, "processor_ms": 1e3 * processor_s / done, "first": list(baseline)}
    print(json.dumps(report))


def store(connection, results, baseline):
    """Commits a group; returns its size."""
    connection.execute("BEGIN")
    for number, theta, covariance in results:
        current, position = TRACES[number % len(TRACES)].astype("<f4")
        drift = bool(np.any(np.abs(theta / baseline - 1) > 0.15))
        row = (number, current.tobytes(), position.tobytes(), *theta, covariance.tobytes(), drift)
        connection.execute("INSERT INTO throw VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
    connection.execute("COMMIT")
    return len(results)


if __name__ == "__main__":
    main()
