import pytest

from .emulated import Controller, configuration

QUIET = (
    ("  variation:              # the axes of a real cell are never quite alike\n", ""),
    ("    y: {preisach_c_um_per_V2: 9.8e-3, stage_kg: 12.4}\n", ""),
    ("    z: {preisach_d_per_V: 0.0165, piezo_N_per_um: 390.0, amplifier_Hz: 880.0}\n", ""),
    (
        "  seed: 1\n  force:",
        "  seed: 1\n  plant: {strain_noise_nm: 0.0, strain_hum_nm: 0.0, stage_noise_nm: 0.0}\n  force:",
    ),
)


@pytest.fixture
def make(tmp_path, closing):
    """A controller on devices of its own, with parts of config/can.yaml replaced."""
    return lambda *changes, **options: closing(Controller(configuration(tmp_path, *changes), **options))


@pytest.fixture
def controller(make):
    """On devices whose sensors have no noise."""
    return make(*QUIET)
