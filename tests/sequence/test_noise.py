from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.sequence.noise import NoiseModel, estimate_noise

SHAPE = (128, 160)


def test_sigma_is_the_root_of_the_line_and_never_less_than_in_the_dark() -> None:
    noise = NoiseModel(4e-6, 1e-4)
    image = np.array([-0.5, 0.0, 0.36], np.float32)
    np.testing.assert_allclose(noise.sigma(image), np.sqrt([4e-6, 4e-6, 4e-5]), rtol=1e-6)
    assert noise.sigma(image).dtype == np.float32


@pytest.mark.parametrize(("read", "gain"), [(1e-6, 3e-5), (2e-4, 6e-4), (4e-6, 0.0)])
def test_the_photon_transfer_line_is_found_under_gradients_columns_and_texture(
    read: float, gain: float
) -> None:
    rng = np.random.default_rng(6)
    shape = (384, 512)
    y, x = np.mgrid[: shape[0], : shape[1]]
    # Cells of different brightness with a gradient; a quarter of them full of texture.
    cells = ((x // 64) + 3 * (y // 64)) % 8 / 10.0 * (1.0 - 0.1 * x / shape[1])
    texture = 0.05 * rng.standard_normal(shape) * (((x // 64) + (y // 64)) % 4 == 0)
    columns = 0.01 * rng.standard_normal(shape[1])
    frames, valid = [], []
    for _ in range(4):
        sigma = np.sqrt(read + gain * cells)
        image = cells + texture + columns + sigma * rng.standard_normal(shape)
        frames.append(image.astype(np.float32))
        valid.append(np.ones(shape, bool))
    noise = estimate_noise(frames, valid)
    for level in (0.0, 0.3, 0.6):
        found = noise.read_variance + noise.shot_gain * level
        assert found == pytest.approx(read + gain * level, rel=0.25)


@pytest.mark.parametrize("value", [0.0, 0.4])
def test_images_without_noise_or_pixels_still_give_a_positive_sigma(value: float) -> None:
    image = np.full(SHAPE, value, np.float32)
    for mask in (np.ones(SHAPE, bool), np.zeros(SHAPE, bool)):
        noise = estimate_noise([image], [mask])
        assert noise.sigma(image).min() > 0.0


def test_few_dark_pixels_do_not_get_nearly_all_the_weight() -> None:
    """A photograph that is cropped to its module shows next to nothing of the line at black."""
    rng = np.random.default_rng(0)
    light = np.tile(np.linspace(0.3, 0.5, 320), (240, 1))
    # The line meets zero at 0.25: at black nothing of it is left.
    frame = (light + rng.normal(0, np.sqrt(1e-4 * (light - 0.25)))).astype(np.float32)
    noise = estimate_noise([frame], [np.ones(frame.shape, bool)])
    dark, bright = noise.sigma(np.array([0.0, 0.4], np.float32)) ** 2
    assert bright / dark < 150
