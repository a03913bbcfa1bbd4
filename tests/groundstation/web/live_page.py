"""The live page's scripts, run in node before a made-up document."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib.resources import files
from typing import Any

import msgspec
import pytest

from groundstation.scene.static_files import text_of
from groundstation.web.live_messages import fleet_message, state_message
from tests.groundstation.console.scenes import SteadyClient, crowd

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="there is no node on this computer")

DOCUMENT = """
class Node {
  constructor() {
    this.children = [];
    this.dataset = {};
    this.style = {};
    this.classList = { toggle() {} };
    this.acts = {};
    this.value = "";
    this.text = "";
  }
  get textContent() { return this.text + this.children.map((one) => one.textContent).join(""); }
  set textContent(text) { this.replaceChildren(); this.text = text; }
  append(child) { this.children.push(child); }
  prepend(child) { this.children.unshift(child); }
  replaceChildren() { this.text = ""; this.children = []; }
  setAttribute() {}
  select() {}
  contains(other) { return other === this || this.children.some((one) => one.contains(other)); }
  querySelectorAll() { return []; }
  addEventListener(kind, act) { this.acts[kind] = act; }
  dispatch(kind, event = {}) { this.acts[kind]({ preventDefault() {}, target: this, ...event }); }
}
const elements = {};
const byId = (id) => (elements[id] ??= new Node());
const browser = new Node();
const sockets = [];
const sent = [];
let now_ms = 1;
let drawNext = null;
let loads = 0;

globalThis.document = Object.assign(new Node(), {
  getElementById: byId,
  createElement: () => new Node(),
  createTextNode: (text) => Object.assign(new Node(), { text }),
});
globalThis.addEventListener = (kind, act) => browser.addEventListener(kind, act);
globalThis.requestAnimationFrame = (act) => (drawNext = act);
globalThis.performance = { now: () => now_ms };
globalThis.setTimeout = (act) => act();
globalThis.location = { href: "http://127.0.0.1:8000/", reload: () => (loads += 1) };
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "#000000" });
globalThis.WebSocket = class extends Node {
  static OPEN = 1;
  readyState = 1;
  constructor() { super(); sockets.push(this); }
  send(text) { sent.push(JSON.parse(text)); }
};

/* Lets a message of the server arrive. */
const hear = (message) => sockets.at(-1).acts.message({ data: JSON.stringify(message) });
/* Lets half a second pass, and the page show what has changed. */
function show() {
  now_ms += 500;
  drawNext();
}
"""
# A scene that notes its lines; it has no canvas.
SCENE = """
const lines = [];
Covey.Scene = class {
  camera = { fit() {} };
  begin() { lines.length = 0; }
  ground() {}
  box() {}
  area() {}
  body() {}
  ring() {}
  label() {}
  line(begin, end, colour, look) { lines.push([begin, end, look]); }
  end() {}
};
Covey.Ground = class { draw() {} };
Covey.moveByPointer = () => {};
"""


def fleet_said() -> dict[str, Any]:
    """The server's first message to a page that may order a fleet of two."""
    message = fleet_message(crowd(2, side_m=8.0), can_order=True)
    said: dict[str, Any] = json.loads(msgspec.json.encode(message))
    return said


def state_said() -> dict[str, Any]:
    """The server's message on the state of a fleet of two, of which nothing was heard yet."""
    client = SteadyClient(crowd(2, side_m=8.0))
    message = state_message(
        client.state, client.fleet, alarms=(), control=None, now_ns=client.now_ns()
    )
    said: dict[str, Any] = json.loads(msgspec.json.encode(message))
    return said


def run_page(acts: str) -> Any:
    """Run the page's scripts and then ``acts``; return the value of its ``found``."""
    own = files("groundstation.web")
    program = "\n".join(
        (
            DOCUMENT,
            text_of("elements.js"),
            text_of("colours.js"),
            SCENE,
            (own / "live_scene.js").read_text(encoding="utf-8"),
            (own / "live.js").read_text(encoding="utf-8"),
            f"const FLEET = {json.dumps(fleet_said())}; const STATE = {json.dumps(state_said())};",
            acts,
            "console.log(JSON.stringify(found));",
        )
    )
    assert NODE is not None
    ended = subprocess.run(
        [NODE, "-"], input=program, capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)
