"""Goals above each other: which are refused, and in what words."""

from groundstation.orders.grammar import parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.plan import plan_order
from onboard.config.fleet import load_fleet


def test_an_order_to_hover_above_another_is_refused_for_cylinders_and_where_it_is_too_low():
    fleet = load_fleet("configs/fleets/above.toml")
    for config, high_m, words in (
        (fleet, 2.5, ""),
        (fleet, 2.3, "1.45 m above"),
        (load_fleet("sih"), 2.5, "any height"),
    ):
        intent = parse(f"goto mav0 0 0 1 mav1 0 0 {high_m}", config)
        planned = plan_order(
            intent, config, None, held=HeldFormation("triangle"), author="x", now_ns=0
        )
        refused = " ".join(planned.refusals.values())
        assert words in refused if words else not refused, refused
