/*
 * The scene of a fleet that flies: vehicles, trails, goals, the ways of the next ten seconds, people,
 * who avoids whom, and how far apart the nearest two are.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const TRAIL_S = 12; // what is drawn of a trail
  const TRAIL_STEP_S = 0.5; // from one point of a trail to the next, at least
  const TRAIL_STEP_M = 0.05;
  const RING_OPACITY = 0.5;

  class LiveScene {
    constructor(canvas, overlay, fleet) {
      this.scene = new Covey.Scene(canvas, overlay);
      this.showsWays = true;
      this._fleet = fleet;
      this._trails = new Map(); // name -> list of [time_s, position]
      Covey.moveByPointer(canvas, this.scene.camera, () => (this.isOld = true));
      this.isOld = true; // it has to be drawn anew
      this._ground = new Covey.Ground(fleet.ground, () => (this.isOld = true));
      this.fit();
    }

    /* Shows all of the fence. */
    fit() {
      const [least, most] = this._fleet.fence_enu_m;
      this.scene.camera.fit(least, most, this.scene.aspect);
      this.isOld = true;
    }

    lookFromAbove() {
      this.scene.camera.lookFromAbove();
      this.isOld = true;
    }

    /* Adds a state to the trails, and forgets their points of before `oldest_s`. */
    follow(state, oldest_s) {
      for (const vehicle of state.vehicles) {
        if (!vehicle.position_enu_m) continue;
        const trail = this._trails.get(vehicle.name) ?? [];
        if (isNextPoint(trail.at(-1), state.time_s, vehicle.position_enu_m)) {
          trail.push([state.time_s, vehicle.position_enu_m]);
        }
        while (trail.length && trail[0][0] < oldest_s) trail.shift();
        this._trails.set(vehicle.name, trail);
      }
    }

    forgetTrails() {
      this._trails.clear();
    }

    /* Draws a state; `aimed` are the names that the next order reaches, `card` an order's preview. */
    draw(state, aimed, card) {
      this.isOld = false;
      const scene = this.scene;
      const [least, most] = this._fleet.fence_enu_m;

      scene.begin();
      this._ground.draw(scene);
      scene.ground(least, most, Covey.rgb(Covey.colour("ground")));
      scene.box(least, most, Covey.rgb(Covey.colour("ground")), { opacity: 0.35 });
      for (const area of this._fleet.areas) {
        scene.area(area, Covey.rgb(Covey.colour(area.keeps_in ? "ground" : "warn")));
      }
      state.people.forEach((person, index) => this._person(person, index));
      state.vehicles.forEach((vehicle, index) => {
        this._vehicle(vehicle, index, aimed, state.time_s);
      });
      this._avoidances(state);
      this._closest(state);
      if (card) this._card(card);
      scene.end();
    }

    /* Draws a vehicle where it is, or pale where it was seen last. */
    _vehicle(vehicle, index, aimed, time_s) {
      const position = vehicle.position_enu_m ?? vehicle.last_enu_m;
      if (!position) return;
      const scene = this.scene;
      const text = Covey.vehicleColour(index);
      const colour = Covey.rgb(text);
      const isAimed = aimed.has(vehicle.name);

      scene.body(position, vehicle.quaternion ?? facing(vehicle.yaw_deg), colour, {
        diameter_m: this._fleet.body_diameter_m,
        opacity: vehicle.position_enu_m ? 1 : 0.4,
      });
      scene.line(position, [position[0], position[1], 0], colour, { opacity: 0.35, width: 1 });
      scene.ring(position, this._fleet.safety_distance_m / 2, colour, {
        opacity: isAimed ? 0.9 : RING_OPACITY,
        width: isAimed ? 2.5 : 1,
      });
      this._trail(vehicle, position, colour, time_s);
      if (this.showsWays && vehicle.way_enu_m?.length) {
        scene.line(vehicle.way_enu_m[0], vehicle.way_enu_m[1], colour, { opacity: 0.6, width: 2 });
        scene.ring(vehicle.goal_enu_m, 0.1, colour, { opacity: 0.8 });
      }
      scene.label(position, vehicleWords(vehicle), { colour: text, isStrong: isAimed });
    }

    /* Draws a person's circle on the ground and at the head, where he was seen last. */
    _person(person, index) {
      const head = person.position_enu_m;
      if (!head) return;
      const text = personColour(person);
      const colour = Covey.rgb(text);
      const { radius_m } = this._fleet.people[index];
      const feet = [head[0], head[1], 0];

      for (const middle of [feet, head]) this.scene.ring(middle, radius_m, colour, { width: 2 });
      this.scene.line(feet, head, colour, { width: 2 });
      this.scene.label(head, personWords(person), { colour: text });
    }

    /* Draws the trail up to this time, and from its last point to the vehicle's position. */
    _trail(vehicle, position, colour, time_s) {
      const kept = this._trails.get(vehicle.name) ?? [];
      const trail = kept.filter(([at_s]) => at_s >= time_s - TRAIL_S && at_s <= time_s);
      trail.forEach(([, point], index) => {
        const next = index + 1 < trail.length ? trail[index + 1][1] : position;
        const opacity = (0.5 * (index + 1)) / trail.length;
        this.scene.line(point, next, colour, { opacity, width: 2 });
      });
    }

    /* Draws from each vehicle that avoids to the one that it avoids. */
    _avoidances(state) {
      const others = [...state.people, ...state.vehicles];
      const positions = new Map(others.map((one) => [one.name, one.position_enu_m]));
      const colour = Covey.rgb(Covey.colour("warn"));
      for (const vehicle of state.vehicles) {
        const other = vehicle.avoids ? positions.get(vehicle.avoids) : null;
        if (!other || !vehicle.position_enu_m) continue;
        this.scene.line(vehicle.position_enu_m, other, colour, { opacity: 0.8, width: 2 });
        const middle = vehicle.position_enu_m.map((axis, k) => 0.7 * axis + 0.3 * other[k]);
        this.scene.label(middle, `${vehicle.name} avoids`, { isQuiet: true, shift: [0, 0] });
      }
    }

    _closest(state) {
      const closest = state.closest;
      if (!closest) return;
      const named = (name) => state.vehicles.find((one) => one.name === name)?.position_enu_m;
      const [first, second] = [named(closest.first), named(closest.second)];
      if (!first || !second) return;

      const isTooNear = areTooNear(closest, this._fleet);
      const colour = Covey.rgb(Covey.colour(isTooNear ? "bad" : "ground"));
      this.scene.line(first, second, colour, { opacity: 0.7, width: isTooNear ? 3 : 1 });
      const middle = first.map((axis, k) => (axis + second[k]) / 2);
      this.scene.label(middle, Covey.number(closest.distance_m, 2, "m"), { shift: [0, 0] });
    }

    /* Draws the goals and the computed paths of an order that waits for its confirmation. */
    _card(card) {
      const names = this._fleet.vehicles;
      for (const [name, goal] of Object.entries(card.goals_enu_m ?? {})) {
        const colour = Covey.rgb(Covey.vehicleColour(names.indexOf(name)));
        this.scene.ring(goal, 0.2, colour, { width: 2.5 });
        this.scene.label(goal, `${name} to here`, { isQuiet: true });
      }
      for (const [name, path] of Object.entries(card.paths_enu_m ?? {})) {
        const colour = Covey.rgb(Covey.vehicleColour(names.indexOf(name)));
        for (let k = 1; k < path.length; k++) {
          this.scene.line(path[k - 1], path[k], colour, { opacity: 0.55, width: 1.5 });
        }
      }
    }
  }

  /* Whether a position is far enough from the last point of a trail, in time and in metres. */
  function isNextPoint(last, time_s, position) {
    if (!last) return true;
    const moved_m = Math.hypot(...position.map((axis, k) => axis - last[1][k]));
    return time_s - last[0] >= TRAIL_STEP_S && moved_m >= TRAIL_STEP_M;
  }

  /* Whether a pair is nearer than the safety distance; both may stand nearer on the ground. */
  function areTooNear(pair, fleet) {
    return pair.is_flying && pair.distance_m < fleet.safety_distance_m;
  }

  /* Returns the attitude of a level vehicle with this heading. */
  function facing(yaw_deg) {
    const half = ((yaw_deg ?? 0) * Math.PI) / 360;
    return [Math.cos(half), 0, 0, Math.sin(half)];
  }

  function personColour(person) {
    return Covey.colour(person.is_fresh ? "warn" : "soft");
  }

  /* Returns a vehicle's name, and why its position now is not known. */
  function vehicleWords(vehicle) {
    if (vehicle.position_enu_m) return vehicle.name;
    return `${vehicle.name}, ${vehicle.is_fresh ? "no position" : "silent"}`;
  }

  /* Returns a person's name, and whether the motion capture sees him. */
  function personWords(person) {
    if (!person.position_enu_m) return `${person.name}, never seen`;
    return person.is_fresh ? person.name : `${person.name}, not seen`;
  }

  Object.assign(Covey, { LiveScene, areTooNear, personColour, personWords });
})();
