"""Lists, reads and sets parameters by MAVSDK, and asks for one that does not exist."""

from __future__ import annotations

from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.plugins.param import ParamError
from vehicle import connected, run


async def param(endpoint: str, seen: dict[str, Any]) -> None:
    """All of them, one of each kind, one too many."""
    _client, system = await connected(endpoint, ComponentType.GROUND_STATION)
    params = ParamAsync(system)
    everything = await params.get_all_params()
    seen["integers"] = len(everything.int_params)
    seen["floats"] = len(everything.float_params)
    names = {p.name for p in (*everything.int_params, *everything.float_params)}
    seen["has"] = sorted(
        names & {"COM_OF_LOSS_T", "MPC_THR_HOVER", "COM_OBL_RC_ACT", "EKF2_EV_CTRL"}
    )
    seen["hover"] = await params.get_param_float("MPC_THR_HOVER")
    await params.set_param_float("MPC_THR_HOVER", 0.55)
    seen["hover_set"] = await params.get_param_float("MPC_THR_HOVER")
    await params.set_param_int("COM_OBL_RC_ACT", 4)
    seen["action_set"] = await params.get_param_int("COM_OBL_RC_ACT")
    for name, read in (
        ("unknown", params.get_param_float("NOT_A_PARAM")),
        ("kind", params.get_param_int("MPC_THR_HOVER")),
    ):
        try:
            await read
            seen[name] = "answered"
        except ParamError as error:
            seen[name] = type(error).__name__


run(param)
