"""What several tests share: where the real recordings are, if they are here at all."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

SHARED = Path(os.environ.get("ANISOMAP_SHARED", Path(__file__).parents[2] / "shared"))


# Where a change is judged, chance must not judge it; elsewhere every run tries something new.
settings.register_profile("repeatable", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def recordings_folder() -> Path:
    """The folder of real recordings; they are not ours to ship, so tests skip without them."""
    folder = SHARED / "recordings"
    if not folder.is_dir():
        pytest.skip("the real recordings are not here (set ANISOMAP_SHARED to their folder)")
    return folder
