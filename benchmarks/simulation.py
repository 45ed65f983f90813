"""Speed of the scenarios on one core."""

from __future__ import annotations

import time
import warnings

from anisomap.errors import AnisomapWarning
from anisomap.simulation import BODIES, SCENARIOS, find_body, simulate


def main(n_frames: int = 1000) -> None:
    """Print frames per second of each scenario, for its simplest and its most complex body."""
    print("| scenario | body | sensors | frames per second |")
    print("|---|---|---|---|")
    bodies = [find_body(name) for name in BODIES]
    for name, scenario in SCENARIOS.items():
        accepted = [body for body in bodies if scenario.accepts(body)]
        most_complex = max(
            accepted, key=lambda body: (len(body.solids), body.solids[0].kind != "sphere")
        )
        for body in (accepted[0], most_complex):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)
                simulate(body, name, n_frames=2)
                begin = time.perf_counter()
                simulate(body, name, n_frames=n_frames)
            speed = n_frames / (time.perf_counter() - begin)
            print(f"| {name} | {body.name} | {body.n_sensors} | {speed:,.0f} |", flush=True)


if __name__ == "__main__":
    main()
