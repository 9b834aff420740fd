"""How tests are run; what they use is in ``shared_fixtures.py``."""

import gc
import os

from hypothesis import settings

settings.register_profile("quick", max_examples=20, deadline=None)
settings.register_profile("long", max_examples=1000, deadline=None)
settings.load_profile("quick")  # pytest --hypothesis-profile=long


# The heap of torch, Hydra and thousands of tests is large, and hardly any of it is ever garbage: walked less
# often, the suite is a tenth quicker.
gc.set_threshold(50_000, 20, 50)


def pytest_configure(config):
    """Import what is tested where tests run, and not in a process that only hands them out."""
    if "PYTEST_XDIST_WORKER" in os.environ or not config.getoption("numprocesses", 0):
        config.pluginmanager.import_plugin("shared_fixtures")


def pytest_collection_finish(session):
    """Leave what was imported and collected out of later walks for garbage."""
    gc.collect()
    gc.freeze()
