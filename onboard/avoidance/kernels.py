"""The law for one vehicle, in plain floats: the text that one drone runs and that numba compiles for many.

The same source runs twice: Python interprets it for a single vehicle, where arrays would cost more than the arithmetic,
and numba compiles it for batches (compiled.py). The array forms in rows.py, prediction.py, projection.py and oist.py
say the same in vectors; they are the oracle of both, and what batches use without numba. Names and order follow them.

So that both can run it: only floats, ints and indexing; no exceptions, powers or numpy; vectors lie one after the other
in one list or array; scratch memory is passed in (``work_sizes``).
"""

from __future__ import annotations

import math
from typing import Any

from onboard.avoidance.constraints import COINCIDENT_M, LARGEST_MARGIN_M, MAX_OBSTACLES, SETTLED_M_S, SPEED_GAIN_1_S
from onboard.avoidance.kernel_projection import INACTIVE, INFEASIBLE, project
from onboard.avoidance.params import LawNumbers

# lists when interpreted, arrays when compiled; of K vectors all 3 K components
Vectors = Any
Scalars = Any
Point = tuple[float, float]

HUGE = 1e5  # positions, velocities and accelerations beyond this are clipped: squares must stay finite
HELD_S, ROUNDABOUT_S = 3.0, 5.0  # held so long, a vehicle calls for a roundabout, for so long
HELD_WISH_M2_S2, HELD_FRAC = 0.04, 0.2  # held: wants to go, and gets on with less than this share of what it wants
MAX_MESSAGE_AGE_S = 0.30  # extrapolating a silent neighbour further than this gains nothing
MAX_COMMAND_AGE_S = 0.25  # a neighbour's last command says little about what it does later
LONGEST_LEAD_S = 1.0
VIOLATED_M_S2 = 1e-10


def work_sizes(neighbours: int, capsules: int) -> tuple[int, int]:
    """Lengths of the scratch memory: per neighbour or capsule, and per row."""
    return max(1, neighbours, capsules), 2 * neighbours + 2 * MAX_OBSTACLES + 5


def bounded(value: float) -> float:
    """Clipped so that squares stay finite; 0 for what is no number."""
    if value != value:
        return 0.0
    return min(max(value, -HUGE), HUGE)


def is_finite_3(v: Vectors, k: int) -> bool:
    """Whether all three components of vector k are finite."""
    return math.isfinite(v[3 * k]) and math.isfinite(v[3 * k + 1]) and math.isfinite(v[3 * k + 2])


def received(
    k: int,
    position: Vectors,
    velocity: Vectors,
    predicted_position: Vectors,
    predicted_velocity: Vectors,
    command: Vectors,
    age_s: float,
    lead_s: float,
    is_cooperative: bool,
    own_lead_s: float,
) -> tuple[bool, float, float, float, float, float, float]:
    """Neighbour k at our own time: whether it is usable, position, velocity, command; see oist._received."""
    age = age_s
    if not 0.0 <= age <= MAX_MESSAGE_AGE_S:
        age = 0.0 if age < 0.0 and math.isfinite(age) else MAX_MESSAGE_AGE_S
    i = 3 * k
    x, y, z = predicted_position[i], predicted_position[i + 1], predicted_position[i + 2]
    v_x, v_y, v_z = predicted_velocity[i], predicted_velocity[i + 1], predicted_velocity[i + 2]
    u_x, u_y, u_z = command[i], command[i + 1], command[i + 2]
    s_x, s_y = velocity[i], velocity[i + 1]
    total = abs(x) + abs(y) + abs(z) + abs(v_x) + abs(v_y) + abs(v_z) + abs(u_x) + abs(u_y) + abs(u_z)
    is_plain = total + abs(s_x) + abs(s_y) < HUGE  # then all are finite, and nothing has to be bounded
    own_word = is_plain
    if not is_plain:
        own_word = is_finite_3(predicted_position, k) and is_finite_3(predicted_velocity, k) and is_finite_3(command, k)
        x, y, v_x, v_y = bounded(x), bounded(y), bounded(v_x), bounded(v_y)
        u_x, u_y, s_x, s_y = bounded(u_x), bounded(u_y), bounded(s_x), bounded(s_y)
    if is_cooperative and own_word:
        lead = lead_s
        if not 0.0 <= lead <= LONGEST_LEAD_S:
            lead = min(max(lead, 0.0), LONGEST_LEAD_S) if math.isfinite(lead) else own_lead_s
        ahead = age + (own_lead_s - lead)
        if ahead >= 0.0:
            held = min(ahead, MAX_COMMAND_AGE_S)
            share = held * (ahead - 0.5 * held)
            x, y = x + ahead * v_x + share * u_x, y + ahead * v_y + share * u_y
            return True, x, y, v_x + held * u_x, v_y + held * u_y, u_x, u_y
        m_x, m_y = 0.0, 0.0
        if lead > 1e-3:
            m_x, m_y = (v_x - s_x) / lead, (v_y - s_y) / lead
        share = 0.5 * ahead * ahead
        x, y = x + ahead * v_x + share * m_x, y + ahead * v_y + share * m_y
        return True, x, y, v_x + ahead * m_x, v_y + ahead * m_y, u_x, u_y
    usable = is_finite_3(position, k) and is_finite_3(velocity, k)
    ahead = age + own_lead_s
    return usable, bounded(position[i]) + ahead * s_x, bounded(position[i + 1]) + ahead * s_y, s_x, s_y, 0.0, 0.0


def known(std: float) -> float:
    """A standard deviation, 0 if unknown."""
    if 0.0 <= std <= 1e3:
        return std
    return min(abs(std), 1e3) if math.isfinite(std) else 0.0


def turn_sign(e_x: float, e_y: float, w_x: float, w_y: float, d: float, is_crowded: bool, direction: int) -> float:
    """+1 counter-clockwise or -1; see rows.turn_direction."""
    if direction == 0 or (is_crowded and direction >= 2):
        return 1.0
    speed = math.sqrt(w_x * w_x + w_y * w_y)
    return -1.0 if e_x * w_y - e_y * w_x < -0.25 * d * max(speed, 0.1) else 1.0


def way_out(w_x: float, w_y: float) -> Point:
    """A tiny separation where there is none: onwards along the relative velocity."""
    speed = math.sqrt(w_x * w_x + w_y * w_y)
    if speed > 1e-6:
        return COINCIDENT_M * (w_x / speed), COINCIDENT_M * (w_y / speed)
    return COINCIDENT_M, 0.0


def held_on(count: float, v_x: float, v_y: float, i_x: float, i_y: float, is_active: bool, t: float) -> float:
    """The next ``LawMemory.held_s`` after t seconds with velocity v and intent i; see oist._held_s."""
    wish_2, along = i_x * i_x + i_y * i_y, v_x * i_x + v_y * i_y
    if count < 0.0:
        count = min(count + t, 0.0)
    elif is_active and wish_2 > HELD_WISH_M2_S2 and along < HELD_FRAC * wish_2:
        count = count + t
    else:
        count = 0.0
    return -ROUNDABOUT_S if count >= HELD_S else count


def ranked(rank: Scalars, count: int, key: Scalars, place: int) -> None:
    """Insert ``place`` into the ``count`` places of ``rank`` that are sorted by ``key``, behind its equals."""
    k = count
    while k > 0 and key[rank[k - 1]] > key[place]:
        rank[k] = rank[k - 1]
        k -= 1
    rank[k] = place


def covey(
    wanted: Point,
    shift: Point,
    radius: float,
    own: tuple[float, float, float, float, float, float, float, float, float],
    position: Vectors,
    velocity: Vectors,
    predicted_position: Vectors,
    predicted_velocity: Vectors,
    command: Vectors,
    intent: Vectors,
    scalars: tuple[Scalars, Scalars, Scalars, Scalars, Scalars],
    is_present: Scalars,
    is_cooperative: Scalars,
    capsules: Vectors,
    n: LawNumbers,
    work: tuple[Scalars, ...],
    places: tuple[Scalars, Scalars],
) -> tuple[float, float, int, float, float, int]:
    """Safe thrust with its status, slack, crowd count and active neighbour; see oist._covey.

    Args:
        own: position, velocity (2 each) predicted, intent (2), standard deviations of position and velocity, and the
            least crowd count to act on.
        scalars: age, lead time, standard deviations of position and velocity, crowd count of each neighbour.
        work: 11 of the first of ``work_sizes`` and 6 of the second; places: one of each, integers.
    """
    u_x, u_y = wanted
    s_x, s_y = shift
    p_x, p_y, v_x, v_y, i_x, i_y, std_p, std_v, floor = own
    age, lead, their_std_p, their_std_v, their_crowd = scalars
    e_x, e_y, w_x, w_y, h_x, h_y, c_x, c_y, gap, reach, full, n_x, n_y, b, m_x, m_y, m_b = work
    rank, chosen = places
    seen = 0
    is_flagged = False
    crowd = 0.0
    part_p, part_v = n.sigma_position * known(std_p), n.sigma_velocity_s * known(std_v)
    own_variance = part_p * part_p + part_v * part_v
    range_2, sigma_p, sigma_v, own_lead = n.range_m * n.range_m, n.sigma_position, n.sigma_velocity_s, n.lead_time_s
    is_full, direction, rotation, fade = n.is_full, n.direction, n.rotation, n.rotation_fade_m_s2
    for k in range(len(age)):
        if not is_present[k]:
            continue
        usable, q_x, q_y, r_x, r_y, a_x, a_y = received(
            k, position, velocity, predicted_position, predicted_velocity, command,
            age[k], lead[k], is_cooperative[k], own_lead,
        )  # fmt: skip
        if not usable:
            is_flagged = True
            continue
        d_x, d_y, z_x, z_y = p_x - q_x, p_y - q_y, v_x - r_x, v_y - r_y
        distance_2 = d_x * d_x + d_y * d_y
        if not distance_2 <= range_2:
            continue
        if distance_2 < COINCIDENT_M * COINCIDENT_M:
            is_flagged = True
            d_x, d_y = way_out(z_x, z_y)
        margin = n.margin_m
        if sigma_p > 0.0:
            part_p, part_v = sigma_p * known(their_std_p[k]), sigma_v * known(their_std_v[k])
            spread = math.sqrt(own_variance + part_p * part_p + part_v * part_v)
            margin = min(max(margin, n.margin_floor_m + spread), LARGEST_MARGIN_M)
        d = n.safety_distance_m + margin + (0.0 if is_cooperative[k] else n.uncooperative_margin_m)
        is_told = direction == 3 and is_cooperative[k] and is_finite_3(intent, k)
        j_x, j_y = 0.0, 0.0
        if is_told:
            j_x, j_y = bounded(intent[3 * k]), bounded(intent[3 * k + 1])
        if distance_2 < 4.0 * d * d and not (is_told and j_x * j_x + j_y * j_y <= SETTLED_M_S * SETTLED_M_S):
            crowd += 1.0
        h_x[k], h_y[k] = (i_x - j_x, i_y - j_y) if is_told else (z_x, z_y)
        e_x[k], e_y[k], w_x[k], w_y[k], c_x[k], c_y[k] = d_x, d_y, z_x, z_y, a_x, a_y
        gap[k], reach[k] = distance_2, d
        full[k] = 1.0 if is_full or not is_cooperative[k] else 0.0
        ranked(rank, seen, gap, k)
        seen += 1
    seen = min(seen, n.max_neighbours)
    crowd = max(crowd, floor)

    # hard rows: neighbours, what stands still, walls; turning rows wait in m_x, m_y, m_b
    hard, turns = 0, 0
    most, active = -math.inf, -1
    is_avoiding = False
    k_3, k_4 = n.kappa_3_1_s, n.kappa_4_1_s
    k_sum, k_product, gain = n.kappa_1_1_s + n.kappa_2_1_s, 0.5 * n.kappa_1_1_s * n.kappa_2_1_s, n.shortfall_gain
    for place in range(seen):
        k = rank[place]
        d, d_x, d_y, z_x, z_y = reach[k], e_x[k], e_y[k], w_x[k], w_y[k]
        closing = d_x * z_x + d_y * z_y
        outside = d_x * d_x + d_y * d_y - d * d
        need = -(z_x * z_x + z_y * z_y) - k_sum * closing
        need -= k_product * outside
        pulled = d_x * c_x[k] + d_y * c_y[k]
        bound = need + pulled if full[k] > 0.0 else 0.5 * need + gain * max(0.0, 0.5 * need + pulled)
        f_x, f_y = d_x / d, d_y / d
        bound = bound / d + f_x * s_x + f_y * s_y
        lack = bound - f_x * u_x - f_y * u_y
        if lack > most:
            most, active = lack, k
        if bound > -radius * math.sqrt(f_x * f_x + f_y * f_y):
            n_x[hard], n_y[hard], b[hard] = f_x, f_y, bound
            hard += 1
        is_violated = lack > VIOLATED_M_S2
        is_avoiding = is_avoiding or is_violated
        if rotation == 2 or (rotation == 1 and is_violated):
            is_crowded = max(crowd, their_crowd[k] if math.isfinite(their_crowd[k]) else 0.0) >= n.crowd_count
            sign = turn_sign(d_x, d_y, h_x[k], h_y[k], d, is_crowded, direction)
            g_x, g_y = (v_x, v_y) if is_full else (z_x, z_y)
            spin = sign * (d_x * g_y - d_y * g_x)
            v_perp = n.v_perp_crowd_m_s if is_crowded and direction >= 2 else n.v_perp_m_s
            braking = -2.0 * k_3 * closing
            if full[k] > 0.0:
                bound = braking - k_4 * (spin - d * v_perp + k_3 * outside) - sign * (z_x * g_y - z_y * g_x)
            else:
                bound = 0.5 * (braking - k_4 * (spin - 2.0 * d * v_perp + k_3 * outside))
            f_x, f_y = -d_y * sign / d, d_x * sign / d
            bound = bound / d + f_x * s_x + f_y * s_y
            if rotation == 1 and lack < fade:
                given = f_x * u_x + f_y * u_y
                bound = given + lack / fade * (bound - given)
            m_x[turns], m_y[turns], m_b[turns] = f_x, f_y, bound
            turns += 1
    for c in range(len(capsules) // 5):
        t_x, t_y = capsules[5 * c + 2] - capsules[5 * c], capsules[5 * c + 3] - capsules[5 * c + 1]
        o_x, o_y = p_x - capsules[5 * c], p_y - capsules[5 * c + 1]
        length_2 = t_x * t_x + t_y * t_y
        along = (o_x * t_x + o_y * t_y) / (length_2 if length_2 > 0.0 else 1.0)
        share = min(max(along, 0.0), 1.0)
        e_x[c], e_y[c] = o_x - share * t_x, o_y - share * t_y
        full[c] = 1.0 if 0.0 < along < 1.0 else 0.0
        gap[c] = math.sqrt(e_x[c] * e_x[c] + e_y[c] * e_y[c]) - capsules[5 * c + 4]
        ranked(rank, c, gap, c)
    for place in range(min(len(capsules) // 5, MAX_OBSTACLES)):
        c = rank[place]
        d_x, d_y = e_x[c], e_y[c]
        if d_x * d_x + d_y * d_y < COINCIDENT_M * COINCIDENT_M:
            d_x, d_y = way_out(v_x, v_y)
        d = capsules[5 * c + 4] + n.clearance_m
        closing, distance_2 = d_x * v_x + d_y * v_y, d_x * d_x + d_y * d_y
        towards = closing * closing / distance_2 if full[c] > 0.0 else v_x * v_x + v_y * v_y
        need = -towards - (n.static_kappa_1_1_s + n.kappa_2_1_s) * closing
        need -= 0.5 * n.static_kappa_1_1_s * n.kappa_2_1_s * (distance_2 - d * d)
        f_x, f_y = d_x / d, d_y / d
        bound = need / d + f_x * s_x + f_y * s_y
        lack = bound - f_x * u_x - f_y * u_y
        if lack > most:
            most, active = lack, -2
        if bound > -radius * math.sqrt(f_x * f_x + f_y * f_y):
            n_x[hard], n_y[hard], b[hard] = f_x, f_y, bound
            hard += 1
        is_violated = lack > VIOLATED_M_S2
        is_avoiding = is_avoiding or is_violated
        if n.rotation == 2 or (n.rotation == 1 and is_violated):
            sign = turn_sign(d_x, d_y, i_x, i_y, d, False, n.direction)
            spin = sign * (d_x * v_y - d_y * v_x)
            bound = -2.0 * k_3 * closing - k_4 * (spin - d * n.v_perp_m_s + k_3 * (distance_2 - d * d))
            if full[c] > 0.0:
                bound -= closing * spin / distance_2
            f_x, f_y = -d_y * sign / d, d_x * sign / d
            m_x[turns], m_y[turns], m_b[turns] = f_x, f_y, bound / d + f_x * s_x + f_y * s_y
            turns += 1
    for wall in range(4):
        f_x, f_y, distance = 0.0, 1.0, p_y - n.fence_low_y_m
        if wall == 0:
            f_x, f_y, distance = 1.0, 0.0, p_x - n.fence_low_x_m
        elif wall == 2:
            f_x, f_y, distance = -1.0, 0.0, n.fence_high_x_m - p_x
        elif wall == 3:
            f_x, f_y, distance = 0.0, -1.0, n.fence_high_y_m - p_y
        if not math.isfinite(distance):
            continue
        bound = -(n.static_kappa_1_1_s + n.kappa_2_1_s) * (f_x * v_x + f_y * v_y)
        bound = bound - n.static_kappa_1_1_s * n.kappa_2_1_s * distance + f_x * s_x + f_y * s_y
        lack = bound - f_x * u_x - f_y * u_y
        if lack > most:
            most, active = lack, -2
        if bound > -radius:
            n_x[hard], n_y[hard], b[hard] = f_x, f_y, bound
            hard += 1
        is_avoiding = is_avoiding or lack > VIOLATED_M_S2
    if not is_avoiding:
        active = -1
        if n.rotation != 2:
            return u_x, u_y, INFEASIBLE if is_flagged else INACTIVE, 0.0, crowd, active

    # soft rows behind the hard ones, the last one dropped first: speed, then turning
    soft = 0
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    if is_avoiding and speed > 1e-6:
        f_x, f_y = -v_x / speed, -v_y / speed
        n_x[hard], n_y[hard] = f_x, f_y
        b[hard] = -SPEED_GAIN_1_S * (n.top_speed_m_s - speed) + f_x * s_x + f_y * s_y
        soft = 1
    for k in range(turns):
        n_x[hard + soft], n_y[hard + soft], b[hard + soft] = m_x[k], m_y[k], m_b[k]
        soft += 1
    x, y, status, slack = project(u_x, u_y, n_x, n_y, b, hard, soft, radius, (m_x, m_y, m_b), chosen)
    return x, y, INFEASIBLE if is_flagged else status, slack, crowd, active
