"""Controller and estimator tuned together, {contestant: fields of Scenario}, in the default world.

Source: `notebooks.further.tune_loops`, with 40 evaluations for each unknown on the training seeds
1000 to 1023, drives of 240 s. The comment is the mean true error on them.
"""

from notebooks.rivals import RIVALS

TUNED: dict[str, dict] = {
    "ekf": dict(  # 0.01476 m
        estimator="ekf",
        r=0.00713,
        q=(1.0, 1.0, 0.0129),
        sigma_w=(0.00112, 0.00112, 0.00752, 0.00945),
    ),
    "fixed_traction": dict(  # 0.01427 m
        estimator=RIVALS["fixed_traction"],
        r=0.00309,
        q=(1.0, 1.0, 0.0597),
        sigma_w=(0.00348, 0.00348, 0.0162, 0.359),
    ),
    "bounded_ekf": dict(  # 0.01409 m
        estimator="bounded_ekf",
        r=0.00452,
        q=(1.0, 1.0, 0.0917),
        sigma_w=(0.00673, 0.00673, 0.0174, 0.209, 0.0483, 0.0152),
    ),
    "rhe": dict(  # 0.01401 m
        estimator="rhe",
        r=0.00272,
        q=(1.0, 1.0, 0.133),
        sigma_w=(0.332, 0.332, 0.00357, 0.003, 0.0131, 0.0186),
        sigma_v=(0.03, 0.03, 0.05, 0.0886),
    ),
    "rhe_yaw_drift": dict(  # 0.01354 m
        estimator="rhe",
        yaw_drift=True,
        r=0.00101,
        q=(1.0, 1.0, 0.0894),
        sigma_w=(0.00125, 0.00125, 0.0287, 0.00171, 5.48, 0.0613, 0.00246),
        sigma_v=(0.03, 0.03, 0.05, 0.0281),
    ),
    "rhe_gyro": dict(  # 0.01150 m
        estimator="rhe",
        sensors=("gyro",),
        r=0.00275,
        q=(1.0, 1.0, 0.112),
        sigma_w=(0.0047, 0.0047, 0.00646, 0.0324, 0.372, 0.103),
        sigma_v=(0.03, 0.03, 0.05, 0.184),
    ),
    "rhe_fixed": dict(  # 0.01421 m
        estimator=RIVALS["rhe_fixed_traction"],
        r=0.00101,
        q=(1.0, 1.0, 0.0324),
        sigma_w=(0.00578, 0.00578, 0.0177, 0.961),
        sigma_v=(0.03, 0.03, 0.05, 0.065),
    ),
    "yaw_drift_ekf": dict(  # 0.01361 m
        estimator=RIVALS["yaw_drift_ekf"],
        r=0.00224,
        q=(1.0, 1.0, 0.0165),
        sigma_w=(0.00374, 0.00374, 0.0106, 5.07, 0.0492, 0.00142, 2.96e-05),
    ),
    "traction_oracle": dict(  # 0.01426 m
        estimator=RIVALS["traction_oracle"],
        r=0.00152,
        q=(1.0, 1.0, 0.076),
        sigma_w=(0.00353, 0.00353, 0.016, 0.099),
    ),
    "drift_oracle": dict(  # 0.01365 m
        estimator=RIVALS["drift_oracle"],
        r=0.014,
        q=(1.0, 1.0, 0.0312),
        sigma_w=(0.0103, 0.0103, 0.0199, 0.273),
    ),
    "oracle": dict(  # 0.00075 m
        estimator="oracle", r=0.001, q=(1.0, 1.0, 0.01)
    ),
}
