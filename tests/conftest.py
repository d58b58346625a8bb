"""Fixtures of all tests."""

from fmu_fixture import fmu, fmu_path, instance  # noqa: F401


def pytest_addoption(parser):
    parser.addoption("--whole", action="store_true", help="the whole scenario on other platforms, not its first 0.4 s")
