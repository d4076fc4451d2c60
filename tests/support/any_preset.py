"""Presets with any values that they may have."""

from __future__ import annotations

from hypothesis import strategies as st

from tactune.core.preset import Preset

POSE = ((1.0, 0.0, 0.0, 0.04), (0.0, 1.0, 0.0, -0.00123), (0.0, 0.0, 1.0, 0.003), (0.0, 0.0, 0.0, 1.0))
HOMOGRAPHY = ((1.01, 0.0, 12.5), (0.0, 0.99, -3.25), (1e-5, 0.0, 1.0))

_span = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(lambda pair: (min(pair), max(pair)))
_limits = st.tuples(st.floats(0, 10), st.floats(0, 10)).filter(lambda p: p[0] != p[1]).map(lambda p: (min(p), max(p)))
presets = st.fixed_dictionaries(
    {
        "name": st.text(min_size=1, max_size=40).filter(lambda text: text.isprintable()),
        "contact_test": st.sampled_from(["tolerance", "membrane"]),
        "alignment.model": st.sampled_from(["rigid", "homography"]),
        "alignment.rigid.T_proximity_tactile": st.sampled_from([None, POSE]),
        "alignment.homography.H_p_t": st.sampled_from([None, HOMOGRAPHY]),
        "alignment.homography.plane_distance_m": st.floats(0.05, 2.0),
        "alignment.depth_scale": st.floats(0.8, 1.25),
        "alignment.depth_offset_m": st.floats(-0.1, 0.1),
        "mask.enabled": st.booleans(),
        "mask.hue": st.tuples(st.integers(0, 179), st.integers(0, 179)),
        "mask.saturation": _span,
        "mask.value": _span,
        "tolerance.t": st.floats(0, 1),
        "membrane.gap_m": st.floats(0, 0.005),
        "membrane.trust_m": st.floats(0.001, 0.2),
        "membrane.shape_px": st.floats(0.5, 30),
        "membrane.bias": st.booleans(),
        "outliers.enabled": st.booleans(),
        "outliers.k": st.integers(1, 1000),
        "outliers.ratio": st.floats(0.01, 100),
        "outliers.min_cluster_area_mm2": st.floats(0, 1e6),
        "range.enabled": st.booleans(),
        "range.limits_m": _limits,
        "region.enabled": st.booleans(),
        "region.rectangle": st.tuples(*[st.integers(1, 16384)] * 4),
    }
).map(lambda values: Preset().with_values(values))
