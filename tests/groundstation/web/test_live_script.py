"""The script of the live page, run in node before a made-up document."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib.resources import files
from typing import Any

import pytest

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="there is no node on this computer")

# An object that takes every call and every value, in place of the document's elements.
DOCUMENT = """
const anything = new Proxy(function () {}, {
  get: (target, key) => (key === Symbol.toPrimitive ? () => 0 : anything),
  set: () => true,
  apply: () => anything,
  construct: () => anything,
});
const sockets = [];
let loads = 0;
globalThis.document = anything;
globalThis.addEventListener = () => {};
globalThis.requestAnimationFrame = () => {};
globalThis.setTimeout = (act) => act();
globalThis.location = { href: "http://127.0.0.1:8000/", reload: () => (loads += 1) };
globalThis.Covey = anything;
globalThis.WebSocket = class {
  constructor() {
    this.on = {};
    sockets.push(this);
  }
  addEventListener(kind, act) {
    this.on[kind] = act;
  }
};
"""
RECONNECT = """
const counts = [];
for (const fleet of FLEETS) {
  const socket = sockets.at(-1);
  socket.on.message({ data: JSON.stringify(fleet) });
  counts.push(loads);
  socket.on.close();
}
console.log(JSON.stringify(counts));
"""


def fleet(name: str, *vehicles: str) -> dict[str, Any]:
    return {
        "kind": "fleet",
        "name": name,
        "vehicles": vehicles,
        "can_order": False,
        "formations": [],
    }


def test_a_page_whose_server_shows_another_fleet_now_is_loaded_again() -> None:
    paper = fleet("paper", "mav0", "mav1")
    fleets = [paper, paper, fleet("hall", "a", "b", "c")]
    script = (files("groundstation.web") / "live.js").read_text(encoding="utf-8")
    program = "\n".join((DOCUMENT, script, f"const FLEETS = {json.dumps(fleets)};", RECONNECT))

    assert NODE is not None
    ended = subprocess.run(
        [NODE, "-"], input=program, capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout) == [0, 0, 1]
