"""Settings of every test run, and the examples in the README and in docstrings as tests."""

import importlib.metadata
import os
import platform

from hypothesis import HealthCheck, settings
from sybil import Sybil
from sybil.parsers.doctest import DocTestParser
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser

from documents import collector, run_commands

# One thread for linear algebra and compiled loops, here and in every process that tests start.
# Matrices of tests are small, and pytest-xdist already runs one process per core: more threads
# would wait for each other. Set before numpy is imported; it reads them only once.
os.environ.update(
    dict.fromkeys(
        (
            "OMP_NUM_THREADS",
            "OPENBLAS_NUM_THREADS",
            "MKL_NUM_THREADS",
            "VECLIB_MAXIMUM_THREADS",
            "NUMBA_NUM_THREADS",
        ),
        os.environ.get("ANISOMAP_TEST_THREADS", "1"),  # more in the workflow arithmetic alone
    )
)

# Property tests draw the same examples on every machine and in every run; the profile `random`
# draws new ones. No deadlines and no check of the speed of generation: on a busy machine they fail
# at random.
settings.register_profile(
    "default",
    deadline=None,
    derandomize=True,
    max_examples=30,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "random",
    settings.get_profile("default"),
    derandomize=False,
    max_examples=200,
    print_blob=True,
)
settings.load_profile("default")


LIBRARIES = ("numpy", "scipy", "scikit-learn", "cyclopts", "matplotlib", "mujoco", "numba")


def pytest_report_header() -> str:
    """State the versions that the tests ran on."""
    known = {each.metadata["Name"]: each.version for each in importlib.metadata.distributions()}
    found = (f"{name} {known.get(name, 'absent')}" for name in LIBRARIES)
    return f"on Python {platform.python_version()} with {', '.join(found)}"


readme = Sybil(
    [PythonCodeBlockParser(), CodeBlockParser("sh", run_commands)], patterns=["README.md"]
)
docstrings = Sybil([DocTestParser()], patterns=["src/**/*.py"])
pytest_collect_file = collector(readme, docstrings)
