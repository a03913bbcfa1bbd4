"""The law for N neighbours in numpy: all rows at once as README.md of the avoidance writes them,
then every active set.

Sound input only. ``p`` are LawParams, ``own`` is a mapping of horizontal vectors.
"""

from __future__ import annotations

import numpy as np

from onboard.avoidance import params as numbers
from tests.oracles.half_planes import least_common_slack, nearest_in_rows_and_disc

INACTIVE = 0
SATURATED = 1
RELAXED = 2


def dot(a, b):
    return (a * b).sum(-1)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def columns(neighbours):
    """One array for each field; vectors horizontal, (K, 2)."""
    fields = neighbours[0]._fields
    arrays = {name: np.array([getattr(n, name) for n in neighbours], float) for name in fields}
    return {name: array[:, :2] if array.ndim == 2 else array for name, array in arrays.items()}


def carried(n, lead_s):
    """Line P3: positions, velocities and commands (K, 2) of the neighbours at the own t + L."""
    cooperative = n["is_cooperative"] > 0
    age = np.clip(n["age_s"], 0.0, np.where(cooperative, 0.8, 0.3))

    their_lead = np.clip(
        np.where(np.isfinite(n["lead_time_s"]), n["lead_time_s"], lead_s), 0.0, 1.0
    )
    ahead = (age + lead_s - their_lead)[:, None]
    longer_lag = np.maximum(lead_s - their_lead, 0.0)[:, None]
    forth = np.clip(ahead, 0.0, longer_lag + 0.08)
    back = np.minimum(ahead, 0.0)

    p = n["predicted_position_enu_m"]
    v = n["predicted_velocity_enu_m_s"]
    u = n["commanded_acceleration_enu_m_s2"]
    mean = (v - n["velocity_enu_m_s"]) / np.maximum(their_lead, 1e-3)[:, None]
    q = p + ahead * v + forth * (ahead - 0.5 * forth) * u + 0.5 * back**2 * mean
    w = v + forth * u + back * mean

    a = n["acceleration_enu_m_s2"]
    m = (age + lead_s)[:, None]
    a = a * np.minimum(1.0, 9.80665 / np.maximum(np.hypot(*a.T), 1e-9))[:, None]
    s = np.minimum(m, 0.25)
    plain = n["position_enu_m"] + m * n["velocity_enu_m_s"] + s * (m - 0.5 * s) * a

    pick = cooperative[:, None]
    return (
        np.where(pick, q, plain),
        np.where(pick, w, n["velocity_enu_m_s"] + s * a),
        np.where(pick, u, 0.0),
    )


def design_distances(own, n, s):
    """Distances (K,) to keep."""
    variance = s.sigma_position**2 * (own["position_std"] ** 2 + n["position_std_m"] ** 2)
    variance = variance + s.sigma_velocity_s**2 * (
        own["velocity_std"] ** 2 + n["velocity_std_m_s"] ** 2
    )

    longer_s = np.clip(np.nan_to_num(n["lead_time_s"]) - s.margin_lag_s, 0.0, 1.0 - s.margin_lag_s)
    for_lag = np.where(n["is_cooperative"] > 0, s.lag_margin_m_s * longer_s, 0.0)
    margin = s.margin_m + for_lag
    if s.sigma_position > 0:
        margin = np.clip(s.margin_floor_m + np.sqrt(variance), margin, 5.0)

    return (
        s.safety_distance_m
        + margin
        + np.where(n["is_cooperative"] > 0, 0.0, s.uncooperative_margin_m)
    )


def need(e, w, d, k_1, k_2):
    """(20) halved, for something that does not accelerate."""
    return -dot(w, w) - (k_1 + k_2) * dot(e, w) - 0.5 * k_1 * k_2 * (dot(e, e) - d * d)


def turn(e, w, v, d, v_perp, sign, g):
    """(21)."""
    outside = dot(e, e) - d * d
    inner = sign * cross(e, v) - d * v_perp + g.kappa_3_1_s * outside
    return -sign * cross(w, v) - 2.0 * g.kappa_3_1_s * dot(e, w) - g.kappa_4_1_s * inner


def sides(e, intent, d, is_crowded, direction):
    """+1 or -1 (K,)."""
    is_left = cross(e, intent) < -0.25 * d * np.maximum(np.sqrt(dot(intent, intent)), 0.1)
    is_fixed = is_crowded & (direction >= numbers.DIRECTION_CROWD)
    return np.where(is_left & ~is_fixed & (direction != numbers.DIRECTION_FIXED), -1.0, 1.0)


def neighbour_rows(own, neighbours, p, is_roundabout):
    """Lines D, R: distance rows, rotation rows, the neighbours' indices (K,), and the own crowd
    count.
    """
    n = columns(neighbours)
    g = p.gains
    policies = p.policies

    q, their_v, u = carried(n, p.lead_time_s)
    e = own["position"] - q
    w = own["velocity"] - their_v
    cooperative = n["is_cooperative"] > 0

    has_intent = (policies.direction == numbers.DIRECTION_INTENT) & cooperative
    has_intent = has_intent & np.isfinite(n["intent_enu_m_s"]).all(-1)
    intent = np.where(has_intent[:, None], own["intent"] - n["intent_enu_m_s"], w)
    if policies.direction == numbers.DIRECTION_INTENT:
        intent = np.where(cooperative[:, None], intent, own["intent"] - their_v)
    is_settled = has_intent & (np.sqrt(dot(n["intent_enu_m_s"], n["intent_enu_m_s"])) <= 0.1)

    d = design_distances(own, n, p.spacing)
    in_range = dot(e, e) <= p.spacing.range_m**2

    crowd = max(
        (in_range & ~is_settled & (dot(e, e) < 4.0 * d * d)).sum(),
        g.crowd_count if is_roundabout else 0,
    )

    order = np.argsort(np.where(in_range, dot(e, e), np.inf), kind="stable")[
        : min(p.spacing.max_neighbours, in_range.sum())
    ]

    e, w, u, d, intent, cooperative = (a[order] for a in (e, w, u, d, intent, cooperative))
    theirs = np.nan_to_num(n["crowd_count"][order])

    needed = need(e, w, d, g.kappa_1_1_s, g.kappa_2_1_s)
    pulled = dot(e, u)
    is_full = ~cooperative | (policies.responsibility == numbers.RESPONSIBILITY_FULL)
    gamma = g.shortfall_gain if policies.responsibility == numbers.RESPONSIBILITY_SHORTFALL else 0.0
    bound = np.where(
        is_full, needed + pulled, 0.5 * needed + gamma * np.maximum(0.0, 0.5 * needed + pulled)
    )

    is_crowded = np.maximum(crowd, theirs) >= g.crowd_count
    sign = sides(e, intent, d, is_crowded, policies.direction)
    v_perp = np.where(
        is_crowded & (policies.direction >= numbers.DIRECTION_CROWD),
        g.v_perp_crowd_m_s,
        g.v_perp_m_s,
    )

    v = own["velocity"] if policies.responsibility == numbers.RESPONSIBILITY_FULL else w
    turning = np.where(
        is_full, turn(e, w, v, d, v_perp, sign, g), 0.5 * turn(e, w, w, d, 2.0 * v_perp, sign, g)
    )

    around = np.stack([-e[:, 1], e[:, 0]], -1) * sign[:, None]
    scale = d[:, None]
    rows = (e / scale, bound / d)
    turns = (around / scale, turning / d, conflicts(e, intent, d))
    return rows, turns, n["table_index"][order].astype(int), crowd, ~cooperative


def conflicts(e, intent, d):
    """0 to 1 (K,): how far the straight ways that both intend come too near."""
    speed = np.maximum(np.sqrt(dot(intent, intent)), 1e-300)
    share = np.clip((0.9 * d - np.abs(cross(e, intent)) / speed) / (0.2 * d), 0.0, 1.0)
    return np.where(
        (dot(e, intent) < 0.0) & (speed >= 1e-6), share * np.minimum(speed / 0.3, 1.0), 0.0
    )


def obstacle_rows(own, capsules, p):
    """The same for the nearest static obstacles."""
    c = np.array([(*one.begin_enu_m, *one.end_enu_m, one.radius_m) for one in capsules]).reshape(
        -1, 5
    )

    along = c[:, 2:4] - c[:, :2]
    offset = own["position"] - c[:, :2]
    share = dot(offset, along) / np.where(dot(along, along) > 0, dot(along, along), 1.0)
    e = offset - np.clip(share, 0.0, 1.0)[:, None] * along

    order = np.argsort(np.sqrt(dot(e, e)) - c[:, 4], kind="stable")[:6]
    e = e[order]
    share = share[order]
    radius = c[order, 4]

    v = np.broadcast_to(own["velocity"], e.shape)
    towards = (dot(e, v) / dot(e, e))[:, None] * e
    w = np.where(((share > 0) & (share < 1))[:, None], towards, v)

    d = radius + p.spacing.clearance_m
    g = p.gains
    bound = need(e, w, d, g.static_kappa_1_1_s, g.kappa_2_1_s)

    sign = sides(
        e, np.broadcast_to(own["intent"], e.shape), d, np.zeros(len(e), bool), p.policies.direction
    )
    turning = turn(e, w, v, d, g.v_perp_m_s, sign, g)
    around = np.stack([-e[:, 1], e[:, 0]], -1) * sign[:, None]
    return (e / d[:, None], bound / d), (around / d[:, None], turning / d, np.zeros(len(d)))


def wall_rows(own, p):
    """The four walls: inward acceleration at least -(k_1 + k_2) h' - k_1 k_2 h."""
    g = p.gains
    f = p.fence
    inward = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])

    (x, y) = own["position"]
    k_1 = g.static_kappa_1_1_s
    k_2 = g.kappa_2_1_s

    gap = np.array([x - f.low_x_m, y - f.low_y_m, f.high_x_m - x, f.high_y_m - y])
    return inward, -(k_1 + k_2) * inward @ own["velocity"] - k_1 * k_2 * gap


def law(own, neighbours, capsules, p, is_roundabout=False):
    """Thrust, status, slack, crowd count and active index; own: position, velocity, intent, thrust,
    compensation, radius, position_std, velocity_std."""
    rotation = p.policies.rotation

    u = own["thrust"]
    parts = []
    turn_parts = []
    indices = []
    is_uncooperative = []

    crowd = least_crowd(p, is_roundabout)
    if neighbours:
        rows, turns, indexes, crowd, is_uncooperative = neighbour_rows(
            own, neighbours, p, is_roundabout
        )
        parts.append(rows)
        turn_parts.append((*turns, True))
        indices.extend(indexes)

    if capsules:
        rows, turns = obstacle_rows(own, capsules, p)
        parts.append(rows)
        turn_parts.append((*turns, False))
        indices.extend([-2] * len(rows[1]))

    parts.append(wall_rows(own, p))
    indices.extend([-2] * 4)

    normals, bounds = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    bounds = bounds + normals @ own["compensation"]
    missing = bounds - normals @ u

    is_avoiding = bool((missing > 1e-10).any())
    active = int(np.array(indices)[np.argmax(missing)]) if is_avoiding else -1

    soft = []
    start = 0
    for turn_normals, turn_bounds, ahead, has_fade in turn_parts:
        for k, normal in enumerate(turn_normals):
            bound = turn_bounds[k] + normal @ own["compensation"]
            shortfall = missing[start + k]
            given = normal @ u
            if rotation == numbers.ROTATION_ALWAYS:
                soft.append((normal, bound))
                continue

            strength = 0.0
            if shortfall > 1e-10 and has_fade:
                strength = min(1.0, shortfall / p.gains.rotation_fade_m_s2)
            elif shortfall > 1e-10:
                strength = 1.0
            if rotation == numbers.ROTATION_AHEAD:
                strength = max(strength, ahead[k])
            if rotation != numbers.ROTATION_NEVER and strength > 0.0:
                soft.append((normal, given + strength * (bound - given)))
        start += len(turn_normals)

    count = len(turn_parts[0][1]) if neighbours else 0
    promised = [np.zeros((0, 2)), np.zeros(0)]
    if neighbours:
        without_margins = p.spacing._replace(
            margin_m=0.0, lag_margin_m_s=0.0, sigma_position=0.0, uncooperative_margin_m=0.0
        )
        bare = p._replace(spacing=without_margins)
        promised = list(neighbour_rows(own, neighbours, bare, is_roundabout)[0])
        promised[1] = promised[1] + promised[0] @ own["compensation"]

    is_fixed = np.isfinite(bounds) & (np.arange(len(bounds)) >= count)
    firm = [
        np.concatenate([a, b[is_fixed]]) for a, b in zip(promised, (normals, bounds), strict=True)
    ]

    yielding = binding(normals[:count], bounds[:count], own["radius"])
    speed = np.hypot(*own["velocity"])
    uncooperative = np.array(is_uncooperative, bool)[:count]
    is_free = (
        bool((bounds[:count] > -own["radius"] * np.hypot(*normals[:count].T))[uncooperative].any())
        if count
        else False
    )

    limit = np.zeros((0, 2)), np.zeros(0)
    if speed > 1e-6:
        noise_m_s = min(own["velocity_std"], 0.25 * p.top_speed_m_s)
        limit_m_s = (p.top_speed_m_s + noise_m_s) * (2.0 if is_free else 1.0)
        normal = -own["velocity"] / speed
        left_m_s = limit_m_s - speed
        largest_m_s2 = 8.0 * left_m_s
        if left_m_s > 0.0 and not is_free:
            largest_m_s2 = min(largest_m_s2, np.sqrt(2.0 * 6.0 * p.top_speed_m_s * left_m_s))
        bound = -largest_m_s2 + normal @ own["compensation"]
        limit = binding(normal[None], np.array([bound]), own["radius"])

    is_limited = bool((limit[1] - limit[0] @ u > 1e-10).any())
    if not is_avoiding and not soft and not is_limited:
        return u, INACTIVE, 0.0, crowd, active

    stiffness = 1e7 if rotation == numbers.ROTATION_ALWAYS else 25.0
    turned = pulled(u, soft, stiffness)
    point, status, slack = projection(turned, yielding, limit, firm, own["radius"])
    if status == INACTIVE and (turned != u).any():
        status = SATURATED
    return point, status, slack, crowd, active


def pulled(u, soft, stiffness):
    """Minimum of |x - u|^2 + stiffness * violations^2, by Newton steps; its gradient proves it."""
    x = u
    if not soft:
        return x
    normals = np.array([normal / np.hypot(*normal) for normal, _ in soft])
    bounds = np.array([bound / np.hypot(*normal) for normal, bound in soft])
    for _ in range(20):
        is_violated = bounds > normals @ x
        pulling, ends = normals[is_violated], bounds[is_violated]
        x = np.linalg.solve(
            np.eye(2) + stiffness * pulling.T @ pulling, u + stiffness * ends @ pulling
        )
    gradient = x - u - stiffness * np.maximum(bounds - normals @ x, 0.0) @ normals
    assert np.abs(gradient).max() < 1e-12 * stiffness + 1e-9
    return x


def least_crowd(p, is_roundabout):
    return float(p.gains.crowd_count) if is_roundabout else 0.0


def binding(normals, bounds, radius):
    """Rows that do not hold in all of the disc."""
    can_bind = bounds > -radius * np.hypot(*normals.T)
    return normals[can_bind], bounds[can_bind]


def projection(u, yielding, limit, firm, radius):
    """Line Q: point, status and slack, by trying every active set; firm: the promised distances and
    what stands.
    """
    firm_normals, firm_bounds = firm
    firm = binding(firm_normals, firm_bounds, radius)
    normals, bounds = (np.concatenate(parts) for parts in zip(yielding, limit, firm, strict=True))
    point = nearest_in_rows_and_disc(u, normals, bounds, radius)
    if point is not None:
        is_same = np.abs(point - u).max() <= 1e-10
        return point, INACTIVE if is_same else SATURATED, 0.0

    if nearest_in_rows_and_disc(u, firm_normals, firm_bounds, radius) is None:
        normals, bounds = firm
    else:  # thirty times and a thousand times as stiff
        normals, bounds = (
            np.concatenate([a, 30.0 * b, 1000.0 * c])
            for a, b, c in zip(yielding, limit, firm, strict=True)
        )
    slack = least_common_slack(normals, bounds, radius)
    return nearest_in_rows_and_disc(u, normals, bounds - slack - 1e-10, radius), RELAXED, slack
