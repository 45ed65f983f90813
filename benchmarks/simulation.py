"""How fast scenarios are simulated, on one core."""

from __future__ import annotations

import time
import warnings

from anisomap.errors import AnisomapWarning
from anisomap.simulation import BODIES, SCENARIOS, find_body, simulate


def main(n_frames: int = 2000) -> None:
    """Print frames a second for each scenario, of its easiest body and of its hardest."""
    print("| scenario | body | sensors | frames a second |")
    print("|---|---|---|---|")
    made = [find_body(name) for name in BODIES]
    for name, scenario in SCENARIOS.items():
        suited = [body for body in made if scenario.accepts(body)]
        hardest = max(suited, key=lambda body: (len(body.solids), body.solids[0].kind != "sphere"))
        for body in (suited[0], hardest):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)
                simulate(body, name, n_frames=2)
                begin = time.perf_counter()
                simulate(body, name, n_frames=n_frames)
            speed = n_frames / (time.perf_counter() - begin)
            print(f"| {name} | {body.name} | {body.n_sensors} | {speed:,.0f} |", flush=True)


if __name__ == "__main__":
    main()
