"""Controller and estimator tuned together, {contestant: fields of Scenario}, in the default world.

Source: `notebooks.further.tune_loops`, with 40 evaluations for each unknown on the training seeds
1000 to 1023, drives of 240 s. The comment is the mean true error on them.
"""

from notebooks.rivals import RIVALS

TUNED: dict[str, dict] = {
    "fixed_traction": dict(  # 0.01326 m
        estimator=RIVALS["fixed_traction"],
        sigma_w=(0.013, 0.013, 0.0335, 0.216),
        q=(1.0, 1.0, 0.0291),
        r=0.0101,
    ),
    "bounded_ekf": dict(  # 0.01328 m
        estimator="bounded_ekf",
        sigma_w=(0.0011, 0.0011, 0.0441, 0.291, 0.0908, 0.0518),
        q=(1.0, 1.0, 0.0288),
        r=0.038,
    ),
    "rhe": dict(  # 0.01320 m
        estimator="rhe",
        arrival_mean="filtered",
        sigma_w=(0.487, 0.487, 0.00701, 0.00969, 0.0742, 0.00167),
        q=(1.0, 1.0, 0.0914),
        sigma_v=(0.03, 0.03, 0.05, 0.11),
        r=0.00183,
    ),
    "rhe_fixed": dict(  # 0.01319 m
        estimator=RIVALS["rhe_fixed_traction"],
        arrival_mean="filtered",
        sigma_w=(0.00927, 0.00927, 0.00138, 1.66),
        q=(1.0, 1.0, 0.0939),
        sigma_v=(0.03, 0.03, 0.05, 0.105),
        r=0.00121,
    ),
    "yaw_drift_ekf": dict(  # 0.01304 m
        estimator=RIVALS["yaw_drift_ekf"],
        sigma_w=(0.00185, 0.00185, 0.0125, 5.84, 0.122, 0.00144, 0.000955),
        q=(1.0, 1.0, 0.0337),
        r=0.00175,
    ),
    "traction_oracle": dict(  # 0.01322 m
        estimator=RIVALS["traction_oracle"],
        sigma_w=(0.012, 0.012, 0.0335, 0.287),
        q=(1.0, 1.0, 0.0338),
        r=0.0108,
    ),
    "oracle": dict(  # 0.00072 m
        estimator="oracle", q=(1.0, 1.0, 0.01), r=0.001
    ),
}
