"""The paper's equations (5)-(22), one after the other, scalar and with the mass, as plainly as they
are printed.
"""

from __future__ import annotations

import numpy as np


def saturated_thrust(
    x, y, x_dot, y_dot, x_o, y_o, x_o_dot, y_o_dot, x_o_ddot, y_o_ddot,
    f_dx, f_dy, m, kappa_1, kappa_2, kappa_3, kappa_4, v_perp, d_inf, direction=8,
):  # fmt: skip
    """F_sat of (22) for one vehicle; ``direction`` 8 or 9 names the equation of the turn
    constraint.
    """
    v_x = x_dot
    v_y = y_dot
    d_o2 = (x - x_o) ** 2 + (y - y_o) ** 2  # (5)
    phi_perp = -(y - y_o) * v_x + (x - x_o) * v_y  # (6)
    m_o = 2.0 / m * np.array([[x - x_o, y - y_o], [-(y - y_o), x - x_o]])  # (11)
    d_1 = (  # (13)
        2 * (x_dot - x_o_dot) ** 2
        + 2 * (y_dot - y_o_dot) ** 2
        - 2 * (x - x_o) * x_o_ddot
        - 2 * (y - y_o) * y_o_ddot
    )
    d_2 = -(y_dot - y_o_dot) * v_x + (x_dot - x_o_dot) * v_y  # (14)
    d_o2_dot = 2 * (x - x_o) * (x_dot - x_o_dot) + 2 * (y - y_o) * (y_dot - y_o_dot)
    force = np.array([f_dx, f_dy])
    u_1 = np.array([1.0, 0.0]) @ m_o @ force  # (15)
    u_2 = 0.5 * np.array([0.0, 1.0]) @ m_o @ force
    h_1 = -d_1 - (kappa_1 + kappa_2) * d_o2_dot - kappa_1 * kappa_2 * (d_o2 - d_inf**2)  # (20)
    if direction == 8:
        h_2 = (  # (21)
            -d_2
            - kappa_3 * d_o2_dot
            - kappa_4 * (phi_perp - d_inf * v_perp)
            - kappa_3 * kappa_4 * (d_o2 - d_inf**2)
        )
        sat_2 = max(h_2, u_2)
    else:  # (9) bounds phi_perp from above: phi_perp_dot <= ... in place of (18)
        upper = (
            -d_2
            + kappa_3 * d_o2_dot
            - kappa_4 * (phi_perp + d_inf * v_perp)
            + kappa_3 * kappa_4 * (d_o2 - d_inf**2)
        )
        sat_2 = min(upper, u_2)
    return np.linalg.inv(m_o) @ np.array([max(h_1, u_1), 2.0 * sat_2])  # (19), (22)
