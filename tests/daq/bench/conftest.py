"""What tests of the bench take from those of the stages."""

from tests.stages.conftest import bench  # noqa: F401 - a fixture
