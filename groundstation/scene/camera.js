/*
 * The camera of a scene: where it looks from, and how it is moved.
 *
 * The camera goes around a point of the fleet's frame (east, north, up; metres). Matrices have 16
 * numbers, column by column, as WebGL takes them.
 *
 *   mouse    drag: around; with shift or the right button: along; wheel: nearer, further
 *   touch    one finger: around; two fingers: along, nearer, further
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const FIELD_OF_VIEW_RAD = (38 * Math.PI) / 180;
  const MIN_DISTANCE_M = 0.5;
  const MAX_DISTANCE_M = 5000;
  const HIGHEST_RAD = Math.PI / 2 - 0.001; // straight from above

  function multiply(a, b) {
    const product = new Float32Array(16);
    for (let column = 0; column < 4; column++) {
      for (let row = 0; row < 4; row++) {
        let sum = 0;
        for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
        product[4 * column + row] = sum;
      }
    }
    return product;
  }

  function perspective(fieldOfView_rad, aspect, near_m, far_m) {
    const f = 1 / Math.tan(fieldOfView_rad / 2);
    const depth = 1 / (near_m - far_m);
    // prettier-ignore
    return new Float32Array([
      f / aspect, 0, 0, 0,
      0, f, 0, 0,
      0, 0, (far_m + near_m) * depth, -1,
      0, 0, 2 * far_m * near_m * depth, 0,
    ]);
  }

  /* Returns the matrix that turns the fleet's frame into the camera's: right, up, backwards. */
  function lookFrom(eye, right, up, backwards) {
    const shift = (axis) => -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2]);
    // prettier-ignore
    return new Float32Array([
      right[0], up[0], backwards[0], 0,
      right[1], up[1], backwards[1], 0,
      right[2], up[2], backwards[2], 0,
      shift(right), shift(up), shift(backwards), 1,
    ]);
  }

  class Camera {
    constructor() {
      this.target = [0, 0, 0];
      this.distance_m = 8;
      this.azimuth_rad = -Math.PI / 2 - 0.45; // from the south, a little from the west
      this.elevation_rad = 0.62;
    }

    /* Shows a box of the fleet's frame as a whole, at the present angles. */
    fit(least, most, aspect = 1.6) {
      this.target = least.map((value, axis) => (value + most[axis]) / 2);
      const radius_m = Math.hypot(...least.map((value, axis) => most[axis] - value)) / 2;
      const narrow = Math.min(1, aspect);
      const needed_m = (Math.max(radius_m, 0.8) / Math.sin(FIELD_OF_VIEW_RAD / 2) / narrow) * 1.04;
      this.distance_m = limited(needed_m, MIN_DISTANCE_M, MAX_DISTANCE_M);
    }

    /* Returns right, up and backwards of the picture, in the fleet's frame. */
    get axes() {
      const [sinA, cosA] = [Math.sin(this.azimuth_rad), Math.cos(this.azimuth_rad)];
      const [sinE, cosE] = [Math.sin(this.elevation_rad), Math.cos(this.elevation_rad)];
      return {
        right: [-sinA, cosA, 0],
        up: [-sinE * cosA, -sinE * sinA, cosE],
        backwards: [cosE * cosA, cosE * sinA, sinE],
      };
    }

    get eye() {
      const { backwards } = this.axes;
      return this.target.map((value, axis) => value + this.distance_m * backwards[axis]);
    }

    /* Returns the matrix from the fleet's frame to the picture. */
    matrix(aspect) {
      const { right, up, backwards } = this.axes;
      const view = lookFrom(this.eye, right, up, backwards);
      const near_m = this.distance_m / 100;
      const far_m = this.distance_m * 60;
      return multiply(perspective(FIELD_OF_VIEW_RAD, aspect, near_m, far_m), view);
    }

    /* Returns how many pixels a metre has at the target. */
    pixelsPerMetre(height_px) {
      return height_px / (2 * this.distance_m * Math.tan(FIELD_OF_VIEW_RAD / 2));
    }

    turn(right_rad, up_rad) {
      this.azimuth_rad -= right_rad;
      this.elevation_rad = limited(this.elevation_rad + up_rad, -0.2, HIGHEST_RAD);
    }

    /* Moves the target along the picture. */
    shift(right_m, up_m) {
      const { right, up } = this.axes;
      this.target = this.target.map(
        (value, axis) => value - right_m * right[axis] + up_m * up[axis],
      );
    }

    zoom(factor) {
      this.distance_m = limited(this.distance_m * factor, MIN_DISTANCE_M, MAX_DISTANCE_M);
    }

    lookFromAbove() {
      this.azimuth_rad = -Math.PI / 2;
      this.elevation_rad = HIGHEST_RAD;
    }
  }

  function limited(value, least, most) {
    return Math.min(most, Math.max(least, value));
  }

  /*
   * Lets mouse, fingers and pen move a camera over an element.
   *
   * `onChange` is called after each move, `onShift` when the target was moved by hand (somebody who
   * moves it away no longer follows a vehicle).
   */
  function moveByPointer(target, camera, onChange, onShift = () => {}) {
    const pointers = new Map(); // id -> last position

    target.addEventListener("pointerdown", (event) => {
      target.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });

    target.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;

      const moved = [event.clientX - last[0], event.clientY - last[1]];
      const spreadBefore_px = spread(pointers);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);

      const isAlong = pointers.size > 1 || event.shiftKey || event.buttons & 6;
      if (isAlong) {
        const perMetre = camera.pixelsPerMetre(target.clientHeight) * pointers.size;
        camera.shift(moved[0] / perMetre, moved[1] / perMetre);
        onShift();
      } else {
        camera.turn((moved[0] / target.clientHeight) * 3, (moved[1] / target.clientHeight) * 3);
      }

      const spreadNow_px = spread(pointers);
      if (spreadBefore_px > 0 && spreadNow_px > 0) camera.zoom(spreadBefore_px / spreadNow_px);
      onChange();
    });

    for (const end of ["pointerup", "pointercancel"]) {
      target.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }

    target.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const lines = event.deltaMode === 1 ? 16 : 1; // Firefox counts lines
        camera.zoom(Math.exp(limited(event.deltaY * lines, -120, 120) * 0.0016));
        onChange();
      },
      { passive: false },
    );
    target.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /* Returns the distance between two fingers; 0 without two. */
  function spread(pointers) {
    if (pointers.size !== 2) return 0;
    const [first, second] = [...pointers.values()];
    return Math.hypot(first[0] - second[0], first[1] - second[1]);
  }

  Object.assign(Covey, { Camera, moveByPointer, multiply });
})();
