"""Philox against its published vectors, and the distributions made of it."""

import numpy as np
import pytest
from scipy import stats

from tilepipe_kernels.core import random

# Random123 1.14, kat_vectors: counter, key, result of philox4x32 with 10 rounds.
KNOWN_ANSWERS = [
    ([0, 0, 0, 0], [0, 0], [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
    ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
    (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ),
]
N = 200_000


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
def test_philox_gives_the_known_answers(counter, key, answer):
    assert [int(word) for word in random.philox_4x32(*map(np.uint64, counter + key))] == answer


def test_the_counter_is_site_sweep_stream_and_the_key_the_seed():
    words = random.random_words(*map(np.uint64, (5 + (7 << 32), 1 + (2 << 32), 3, 4)))
    expected = random.philox_4x32(*map(np.uint64, (1, 2, 3, 4, 5, 7)))
    assert words == expected


def test_logarithm_and_sine_are_accurate():
    u = np.concatenate([np.random.default_rng(0).random(5000), 1 - 2.0 ** -np.arange(1, 54), 2.0 ** -np.arange(1, 54)])
    logs = np.array([random.log_of_unit(value) for value in u])
    assert np.allclose(logs, np.log(u), rtol=1e-14, atol=0)
    t = np.linspace(-0.5, 0.5, 5001)
    assert np.allclose([random.sine_of_half_turns(v) for v in t], np.sin(np.pi * t), rtol=0, atol=1e-15)


def test_uniforms_are_uniform_and_never_0_or_1():
    u = random.uniforms(np.arange(N), seed=1)
    assert stats.kstest(u, "uniform").pvalue > 0.01
    ends = [random.unit_from_words(np.uint64(w), np.uint64(w)) for w in (0, 2**32 - 1)]
    assert 0 < ends[0] < 2.0**-52 and 1 - 2.0**-52 < ends[1] < 1


def test_normals_are_normal():
    z = random.normals(np.arange(N), seed=2, sweep=3)
    assert stats.kstest(z, "norm").pvalue > 0.01
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((z**power).mean() - moment) < 4 * np.sqrt(variance / N)
    tail = (np.abs(z) > 4).sum()
    assert abs(tail - 2 * stats.norm.sf(4) * N) < 4 * np.sqrt(2 * stats.norm.sf(4) * N)


def test_a_normal_is_box_and_muller_of_its_words():
    for site in range(50):
        arguments = [np.uint64(value) for value in (3, site, 1, 2)]
        words = random.random_words(*arguments)
        u, t = random.unit_from_words(*words[:2]), random.unit_from_words(*words[2:]) - 0.5
        assert random.normal(*arguments) == pytest.approx(np.sqrt(-2 * np.log(u)) * np.sin(np.pi * t), rel=1e-13)


def test_sites_sweeps_streams_and_seeds_are_independent():
    sites = np.arange(20_000)
    base = random.normals(sites, seed=0)
    others = [random.normals(sites, 0, 1), random.normals(sites, 0, 0, 1), random.normals(sites, 1), np.roll(base, 1)]
    for other in others:
        assert abs(np.corrcoef(base, other)[0, 1]) < 4 / np.sqrt(sites.size)


def test_a_draw_depends_on_its_site_alone():
    sites = np.array([[9, 2**40 + 5], [3, 3]])
    z = random.normals(sites, seed=4, sweep=7)
    whole = random.normals(np.arange(12), seed=4, sweep=7)
    assert z[0, 0] == whole[9] and z[1, 0] == z[1, 1] == whole[3] and z[0, 1] != whole[5]
    arguments = [np.uint64(value) for value in (4, 2**40 + 5, 7, 0)]
    assert z[0, 1] == random.normal(*arguments)


@pytest.mark.parametrize("shape", [0.5, 1.0, 3.7, 1000.5])
def test_gammas_are_gamma(shape):
    draws = [random.gamma(shape, np.uint64(1), np.uint64(5), np.uint64(i)) for i in range(5000)]
    assert stats.kstest(draws, "gamma", args=(shape,)).pvalue > 0.01


def test_seeds_and_sweeps_out_of_range_are_refused():
    for arguments in ((-1,), (2**64,), (0, -1), (0, 2**32), (0, 0, 2**31)):
        with pytest.raises(ValueError, match="must be"):
            random.normals([0], *arguments)
