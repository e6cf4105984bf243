# SPDX-License-Identifier: GPL-3.0-or-later
"""Differences between candidates are named: exchanged limbs, rotations, other places."""

import numpy as np
import pytest

from zoomout_core.matching.ranking import candidate_differences
from zoomout_core.matching.ranking.candidate_differences import differences


def line(start, end, count=40):
    return np.linspace(start, end, count)


# Points per limb of an upright person who faces -Y, and of a dog that is twice as long as high.
PERSON = {
    "trunk": line((0, 0, 0.9), (0, 0.05, 1.7), 60),
    "nose": line((0, 0, 1.6), (0, -0.15, 1.6), 10),
    "left arm": line((0.1, 0, 1.4), (0.8, -0.1, 1.4)),
    "right arm": line((-0.1, 0, 1.4), (-0.8, -0.1, 1.4)),
    "left leg": line((0.1, 0, 0.9), (0.2, -0.05, 0)),
    "right leg": line((-0.1, 0, 0.9), (-0.2, -0.05, 0)),
}
DOG = {
    "trunk": line((0, 0.6, 0.5), (0, -0.8, 0.8), 60),
    "left fore leg": line((0.1, -0.4, 0.5), (0.1, -0.4, 0)),
    "right fore leg": line((-0.1, -0.4, 0.5), (-0.1, -0.4, 0)),
    "left hind leg": line((0.1, 0.5, 0.5), (0.1, 0.5, 0)),
    "right hind leg": line((-0.1, 0.5, 0.5), (-0.1, 0.5, 0)),
}
LEFT_RIGHT, FRONT_BACK, UP_DOWN = np.array([-1, 1, 1]), np.array([1, -1, 1]), np.array([1, 1, -1])


def points(limbs, **exchanged):
    """All points, with those of some limbs replaced by those of others."""
    renamed = {name.replace("_", " "): other for name, other in exchanged.items()}
    return np.concatenate([limbs[renamed.get(name, name)] for name in limbs])


def mirrored_about_center(here, signs):
    center = (here.min(axis=0) + here.max(axis=0)) / 2
    return center + (here - center) * signs


def name_of(here, there, mirrored=False):
    best, name = differences([here, there], [False, mirrored])
    assert best == candidate_differences.BEST
    return name


@pytest.mark.parametrize(
    ("signs", "name"),
    [
        (LEFT_RIGHT, candidate_differences.SIDES),
        (FRONT_BACK, candidate_differences.FRONT),
        (LEFT_RIGHT * FRONT_BACK, candidate_differences.AROUND),
        (FRONT_BACK * UP_DOWN, candidate_differences.UPSIDE_DOWN),
    ],
)
def test_rotation_or_reflection_of_the_whole_is_named(signs, name):
    here = points(DOG)
    there = mirrored_about_center(here, signs) + np.random.default_rng(0).normal(0, 0.01, here.shape)
    assert name_of(here, there) == name
    # Either horizontal axis may be the lateral one.
    assert name_of(here[:, [1, 0, 2]], there[:, [1, 0, 2]]) == name


def test_swapped_limbs_are_named():
    here = points(PERSON)
    arms = points(PERSON, left_arm="right arm", right_arm="left arm")
    legs = points(PERSON, left_leg="right leg", right_leg="left leg")
    assert name_of(here, arms) == candidate_differences.ARMS
    assert name_of(here, legs) == candidate_differences.LEGS
    crossed = points(PERSON, left_arm="left leg", left_leg="left arm")
    assert name_of(here, crossed) == candidate_differences.LIMBS
    dog = points(DOG, left_fore_leg="left hind leg", left_hind_leg="left fore leg")
    assert name_of(points(DOG), dog) == candidate_differences.LEGS


def test_other_differences_are_named_by_top_or_bottom():
    here = points(PERSON)
    above, below = here.copy(), here.copy()
    above[here[:, 0] > 0.3] += (0, 0, 0.6)
    below[here[:, 2] < 0.3] += (0, 0.6, 0)
    assert name_of(here, above) == candidate_differences.TOP
    assert name_of(here, below) == candidate_differences.BOTTOM
    slightly = here + (here[:, [2]] < 0.5) * [0, 0.01, 0]
    assert name_of(here, slightly) == candidate_differences.BOTTOM


def test_mirrored_candidate_is_named_a_mirror_image():
    here = points(PERSON)
    assert name_of(here, here, mirrored=True) == candidate_differences.MIRROR
