"""Fixtures of all tests."""

from fmu_fixture import fmu, fmu_path, instance  # noqa: F401
