/*
 * A scene of vehicles in three dimensions, drawn anew for each picture.
 *
 * Whoever shows something calls `begin`, then `body`, `line`, `path`, `ring`, `box`, `ground`,
 * `picture` and `label` in any order, then `end`. The calls only collect numbers; `end` draws all lines at once and
 * all bodies at once, so that a hundred vehicles cost three calls of WebGL2. Labels are drawn on a
 * second canvas that lies above: text stays sharp, and never covers other text.
 *
 * Where a browser has no WebGL2 the same lines and bodies are drawn on the second canvas, flat, and
 * pictures are left out.
 *
 * Positions are in the fleet's frame: east, north, up, in metres. Colours are red, green and blue
 * from 0 to 1.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  // A line is three texels of four numbers: an end and the width, an end and the opacity, the colour.
  const LINE_TEXELS = 3;
  const LINE_NUMBERS = 4 * LINE_TEXELS;
  const LINES_A_ROW = 512; // of the texture that holds the lines
  const BODY_NUMBERS = 12; // position of 3, quaternion of 4, colour and opacity of 4, scale
  const RING_CORNERS = 48; // of a large one
  const MIN_RING_CORNERS = 8;
  const MIN_BODY_PX = 17;
  const FAR_BODY_PX = 40; // a smaller body is drawn in its simple shape
  const RECTANGLE = [0, 1, 2, 2, 1, 3]; // the corners of its two triangles
  const SHAPES = ["near", "far"];
  const MAX_PIXELS_PER_POINT = 2;
  const PICTURE_OPACITY = 0.75;
  const CREDIT_MARGIN_PX = 6;
  const HALO_PX = 4;
  const MAX_WRITINGS = 1000;

  const LINE_VERTEX = `#version 300 es
    // A line is a rectangle of two triangles, turned towards the picture. Its numbers come from a
    // texture: an instance for each line would be several times slower where no graphics card draws.
    precision highp float;
    uniform highp sampler2D lines;
    uniform mat4 matrix;
    uniform vec2 size_px;
    out vec4 tint;
    out float across_px;
    out float half_px;

    void main() {
      int line = gl_VertexID / 4;
      vec2 corner = vec2(gl_VertexID / 2 % 2, gl_VertexID % 2 * 2 - 1); // along 0..1, across -1..1
      ivec2 texel = ivec2(line % ${LINES_A_ROW} * ${LINE_TEXELS}, line / ${LINES_A_ROW});
      vec4 first = texelFetch(lines, texel, 0);
      vec4 second = texelFetch(lines, texel + ivec2(1, 0), 0);
      vec3 colour = texelFetch(lines, texel + ivec2(2, 0), 0).rgb;
      float width_px = first.w;
      float opacity = second.w;

      vec4 begin = matrix * vec4(first.xyz, 1.0);
      vec4 end = matrix * vec4(second.xyz, 1.0);

      // What lies behind the camera is cut off.
      float near = 0.001;
      if (begin.w < near && end.w < near) {
        gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
        return;
      }
      if (begin.w < near) begin = mix(begin, end, (near - begin.w) / (end.w - begin.w));
      if (end.w < near) end = mix(end, begin, (near - end.w) / (begin.w - end.w));

      vec2 begin_px = begin.xy / begin.w * size_px * 0.5;
      vec2 end_px = end.xy / end.w * size_px * 0.5;
      vec2 along = end_px - begin_px;
      along = length(along) < 0.0001 ? vec2(1.0, 0.0) : normalize(along);
      vec2 normal = vec2(-along.y, along.x);

      half_px = width_px * 0.5 + 1.0;
      across_px = corner.y * half_px;
      vec4 place = mix(begin, end, corner.x);
      place.xy += normal * across_px / (size_px * 0.5) * place.w;
      gl_Position = place;
      tint = vec4(colour, opacity);
    }`;

  const LINE_FRAGMENT = `#version 300 es
    precision mediump float;
    in vec4 tint;
    in float across_px;
    in float half_px;
    out vec4 pixel;

    void main() {
      float coverage = clamp(half_px - 0.5 - abs(across_px), 0.0, 1.0);
      pixel = vec4(tint.rgb, tint.a * coverage);
    }`;

  const PICTURE_VERTEX = `#version 300 es
    layout(location = 0) in vec3 point;
    layout(location = 1) in vec2 share; // of the picture: right and down
    uniform mat4 matrix;
    out vec2 at;
    void main() {
      gl_Position = matrix * vec4(point, 1.0);
      at = share;
    }`;

  const PICTURE_FRAGMENT = `#version 300 es
    precision mediump float;
    uniform sampler2D picture;
    uniform float opacity;
    in vec2 at;
    out vec4 pixel;
    void main() {
      vec4 colour = texture(picture, at);
      pixel = vec4(colour.rgb, colour.a * opacity);
    }`;

  const BODY_VERTEX = `#version 300 es
    layout(location = 0) in vec3 point; // of the body: forward, left, up; 1 is half a diameter
    layout(location = 1) in vec3 normal;
    layout(location = 2) in float shade; // 0: the vehicle's colour; 1: light, for its nose
    layout(location = 3) in vec3 position;
    layout(location = 4) in vec4 quaternion; // w, x, y, z
    layout(location = 5) in vec4 colour;
    layout(location = 6) in float scale;
    uniform mat4 matrix;
    out vec4 tint;

    vec3 turned(vec3 v) {
      return v + 2.0 * cross(quaternion.yzw, cross(quaternion.yzw, v) + quaternion.x * v);
    }

    void main() {
      gl_Position = matrix * vec4(position + turned(point * scale), 1.0);
      float light = 0.72 + 0.28 * dot(turned(normal), normalize(vec3(0.35, -0.5, 0.8)));
      tint = vec4(mix(colour.rgb, vec3(1.0), shade) * light, colour.a);
    }`;

  const BODY_FRAGMENT = `#version 300 es
    precision mediump float;
    in vec4 tint;
    out vec4 pixel;
    void main() { pixel = tint; }`;

  // -- the shape of a vehicle ------------------------------------------------------------------------

  /*
   * Returns the triangles of a quadrotor, 7 numbers a corner: point, normal, shade.
   *
   * isSimple: a quarter of the triangles, for a vehicle that is a few pixels wide: its rotors and
   * arms are flat. Where no graphics card draws, each triangle takes time, whatever its size.
   */
  function quadrotor({ isSimple = false } = {}) {
    const numbers = [];
    const corner = (point, normal, shade) => numbers.push(...point, ...normal, shade);

    const triangle = (a, b, c, shade) => {
      const [u, v] = [minus(b, a), minus(c, a)];
      const normal = unit(cross(u, v));
      for (const point of [a, b, c]) corner(point, normal, shade);
    };

    const bar = (from, to, half, height, shade, isFlat = false) => {
      const along = unit(minus(to, from));
      const side = [-along[1] * half, along[0] * half, 0];
      const at = (end, across, up) => [
        end[0] + across * side[0],
        end[1] + across * side[1],
        end[2] + up * height,
      ];
      const [a, b, c, d] = [at(from, 1, 1), at(from, -1, 1), at(to, -1, 1), at(to, 1, 1)];
      if (isFlat) {
        triangle(a, b, c, shade);
        triangle(a, c, d, shade);
        return;
      }
      const [e, f, g, h] = [at(from, 1, -1), at(from, -1, -1), at(to, -1, -1), at(to, 1, -1)];
      for (const [p, q, r, s] of [
        [a, b, c, d], [h, g, f, e], [a, d, h, e], [b, f, g, c], [d, c, g, h], [a, e, f, b],
      ]) {
        triangle(p, q, r, shade);
        triangle(p, r, s, shade);
      }
    };

    const rotor = (middle, radius) => {
      const corners = isSimple ? 6 : 12;
      for (let k = 0; k < corners; k++) {
        const at = (index, height) => {
          const angle = (2 * Math.PI * index) / corners;
          const [x, y] = [radius * Math.cos(angle), radius * Math.sin(angle)];
          return [middle[0] + x, middle[1] + y, middle[2] + height];
        };
        const [top, bottom] = [0.03, -0.03];
        const [a, b, c, d] = [at(k, top), at(k + 1, top), at(k + 1, bottom), at(k, bottom)];
        triangle([middle[0], middle[1], middle[2] + top], a, b, 0.12); // seen from below, too
        if (isSimple) continue;
        triangle(a, d, b, 0);
        triangle(b, d, c, 0);
      }
    };

    const reach = 0.62; // of the rotors' axes
    for (const [x, y] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
      const tip = [(x * reach) / Math.SQRT2, (y * reach) / Math.SQRT2, 0];
      bar([0, 0, 0], tip, 0.05, 0.035, 0, isSimple);
      rotor([tip[0], tip[1], 0.08], 0.36);
    }
    bar([-0.2, 0, 0.02], [0.2, 0, 0.02], 0.15, 0.1, 0);
    bar([0.2, 0, 0.03], [0.42, 0, 0.03], 0.07, 0.05, 0.75); // the nose
    return new Float32Array(numbers);
  }

  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [
    a[1] * b[2] - a[2] * b[1],
    a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0],
  ];
  const unit = (a) => {
    const length = Math.hypot(...a) || 1;
    return [a[0] / length, a[1] / length, a[2] / length];
  };

  // -- numbers of one picture ------------------------------------------------------------------------

  /* Numbers that grow as needed, and are kept from picture to picture. */
  class Numbers {
    constructor() {
      this.values = new Float32Array(4096);
      this.length = 0;
    }

    clear() {
      this.length = 0;
    }

    /* Makes room for so many more, and returns where they begin. */
    more(count) {
      const begin = this.length;
      this.length += count;
      if (this.length > this.values.length) {
        const larger = new Float32Array(Math.max(this.length, 2 * this.values.length));
        larger.set(this.values);
        this.values = larger;
      }
      return begin;
    }

    get written() {
      return this.values.subarray(0, this.length);
    }

    /* Returns what is written, and so much of what lies behind it that the length is whole rows. */
    wholeRows(row) {
      const length = Math.ceil(this.length / row) * row;
      const written = this.length;
      this.more(length - written);
      this.length = written;
      return this.values.subarray(0, length);
    }
  }

  /* Returns room for the numbers of bodies, by the shape in which they are drawn. */
  function bodies() {
    return { near: new Numbers(), far: new Numbers() };
  }

  // -- the scene -------------------------------------------------------------------------------------

  class Scene {
    /*
     * canvas: for lines and bodies; overlay: a canvas of the same size above it, for labels.
     */
    constructor(canvas, overlay) {
      this.camera = new Covey.Camera();
      this._canvas = canvas;
      this._overlay = overlay;
      this._lines = new Numbers();
      this._solid = bodies();
      this._ghosts = bodies(); // one can see through them
      this._labels = [];
      this._writings = new Writings();
      this._pictures = [];
      this._credit = "";

      // Opaque: nothing shines through it, so a browser that draws in software has half of the work.
      // Desynchronized: there it copies each canvas once less.
      const isSoftware = !hasGraphicsCard();
      this._context = overlay.getContext("2d", { desynchronized: isSoftware });
      this._gl = canvas.getContext("webgl2", {
        alpha: false,
        antialias: !isSoftware,
        desynchronized: isSoftware,
      });
      this._gpu = this._gl ? new Drawer(this._gl) : null;
      canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
      canvas.addEventListener("webglcontextrestored", () => {
        this._gpu = new Drawer(this._gl);
      });
    }

    /* Whether the computer draws it in three dimensions. */
    get hasWebGl() {
      return this._gpu !== null;
    }

    get width_px() {
      return this._canvas.clientWidth;
    }

    get aspect() {
      return this._canvas.clientWidth / Math.max(1, this._canvas.clientHeight);
    }

    /* Begins a picture. */
    begin() {
      this._lines.clear();
      for (const shape of SHAPES) {
        this._solid[shape].clear();
        this._ghosts[shape].clear();
      }
      this._labels = [];
      this._pictures = [];
      this._credit = "";

      // Asked once a picture: the browser has to lay the page out to tell.
      this._width_px = this._canvas.clientWidth;
      this._height_px = this._canvas.clientHeight;

      const ratio = Math.min(globalThis.devicePixelRatio || 1, MAX_PIXELS_PER_POINT);
      const width_px = Math.max(1, Math.round(this._width_px * ratio));
      const height_px = Math.max(1, Math.round(this._height_px * ratio));
      for (const canvas of [this._canvas, this._overlay]) {
        if (canvas.width !== width_px) canvas.width = width_px;
        if (canvas.height !== height_px) canvas.height = height_px;
      }
      this._ratio = ratio;
      this._matrix = this.camera.matrix(width_px / height_px);
      this._eye = this.camera.eye;
    }

    /* Adds a straight line. */
    line(first, second, colour, { opacity = 1, width = 1.5 } = {}) {
      const at = this._lines.more(LINE_NUMBERS);
      const values = this._lines.values;
      values[at] = first[0];
      values[at + 1] = first[1];
      values[at + 2] = first[2];
      values[at + 3] = width;
      values[at + 4] = second[0];
      values[at + 5] = second[1];
      values[at + 6] = second[2];
      values[at + 7] = opacity;
      values[at + 8] = colour[0];
      values[at + 9] = colour[1];
      values[at + 10] = colour[2];
    }

    /*
     * Adds a path through points (x, y, z, x, y, z, ...); where a number is NaN it is interrupted.
     *
     * from, to: first and last point; isFading: its first part is transparent; dash: this many pieces are
     * drawn, then as many left out.
     */
    path(
      points,
      colour,
      { from = 0, to = points.length / 3 - 1, opacity = 1, width = 2, isFading = false, dash = 0 } = {},
    ) {
      const first = [0, 0, 0];
      const second = [0, 0, 0];
      for (let index = from; index < to; index++) {
        if (dash && Math.floor(index / dash) % 2) continue;

        for (let axis = 0; axis < 3; axis++) {
          first[axis] = points[3 * index + axis];
          second[axis] = points[3 * index + 3 + axis];
        }
        if (Number.isNaN(first[0]) || Number.isNaN(second[0])) continue;

        const share = isFading ? (index - from + 1) / (to - from) : 1;
        this.line(first, second, colour, { opacity: opacity * share, width });
      }
    }

    /* Adds a level circle. */
    ring(middle, radius_m, colour, { opacity = 1, width = 1.5 } = {}) {
      // With so many corners a ring of this size is off a circle by less than a third of a pixel.
      const radius_px = radius_m * this._pixelsPerMetreAt(middle);
      const corners = Math.ceil(
        Math.min(Math.max(4 * Math.sqrt(radius_px), MIN_RING_CORNERS), RING_CORNERS),
      );

      let last = null;
      for (let k = 0; k <= corners; k++) {
        const angle = (2 * Math.PI * k) / corners;
        const x = middle[0] + radius_m * Math.cos(angle);
        const y = middle[1] + radius_m * Math.sin(angle);
        const point = [x, y, middle[2]];
        if (last) this.line(last, point, colour, { opacity, width });
        last = point;
      }
    }

    /* Adds the twelve edges of a box. */
    box(least, most, colour, { opacity = 0.5, width = 1 } = {}) {
      const at = (corner) =>
        [0, 1, 2].map((axis) => ((corner >> axis) & 1 ? most[axis] : least[axis]));
      for (let corner = 0; corner < 8; corner++) {
        for (let axis = 0; axis < 3; axis++) {
          const other = corner | (1 << axis);
          if (other !== corner) this.line(at(corner), at(other), colour, { opacity, width });
        }
      }
    }

    /* Adds an area to stay in or out of: its outline below and above, and its upright edges. */
    area(area, colour, { opacity = 0.8, width = 1.5 } = {}) {
      const corners = area.corners_enu_m;
      const step = Math.max(1, Math.floor(corners.length / 12)); // a circle has many corners
      corners.forEach(([x, y], index) => {
        const [nextX, nextY] = corners[(index + 1) % corners.length];
        for (const height_m of [area.low_m, area.high_m]) {
          this.line([x, y, height_m], [nextX, nextY, height_m], colour, { opacity, width });
        }
        if (index % step === 0) {
          this.line([x, y, area.low_m], [x, y, area.high_m], colour, { opacity: opacity / 3, width: 1 });
        }
      });
      const [x, y] = corners[0];
      this.label([x, y, area.low_m], area.name, { isQuiet: true });
    }

    /* Adds a picture below everything else: its corners are left and right above, then below. */
    picture(image, corners) {
      this._pictures.push({ image, corners });
    }

    /* Adds who made the pictures, in the lower right corner. */
    credit(text) {
      this._credit = text;
    }

    /* Adds the ground: a grid with its axes east and north named, around a box. */
    ground(least, most, colour) {
      const size_m = Math.max(most[0] - least[0], most[1] - least[1]);
      const step_m = niceStep(size_m / 8);
      const begin = [0, 1].map((axis) => Math.floor(least[axis] / step_m) * step_m);
      const end = [0, 1].map((axis) => Math.ceil(most[axis] / step_m) * step_m);

      const count = (axis) => Math.round((end[axis] - begin[axis]) / step_m);
      for (let k = 0; k <= count(0); k++) {
        const x = begin[0] + k * step_m;
        const opacity = Math.abs(x) < step_m / 100 ? 0.75 : 0.35;
        this.line([x, begin[1], 0], [x, end[1], 0], colour, { opacity, width: 1 });
        this.label([x, begin[1], 0], metres(x), { shift: [0, 9], isQuiet: true });
      }
      for (let k = 0; k <= count(1); k++) {
        const y = begin[1] + k * step_m;
        const opacity = Math.abs(y) < step_m / 100 ? 0.75 : 0.35;
        this.line([begin[0], y, 0], [end[0], y, 0], colour, { opacity, width: 1 });
        if (k > 0) this.label([begin[0], y, 0], metres(y), { shift: [-12, 0], isQuiet: true });
      }
      this.label([end[0], begin[1], 0], "east [m]", { shift: [34, 9], isQuiet: true });
      this.label([begin[0], end[1], 0], "north [m]", { shift: [0, -14], isQuiet: true });
    }

    /*
     * Adds a vehicle.
     *
     * quaternion: w, x, y, z from its body (forward, left, up) to the fleet's frame; null: level.
     * A vehicle that is far away is drawn larger than it is, so that one still sees it.
     */
    body(position, quaternion, colour, { opacity = 1, diameter_m = 0.5 } = {}) {
      const pixelsPerMetre = this._pixelsPerMetreAt(position);
      const scale_m = Math.max(diameter_m, MIN_BODY_PX / pixelsPerMetre) / 2;

      const bodiesOfKind = opacity < 1 ? this._ghosts : this._solid;
      const isFar = diameter_m * pixelsPerMetre < FAR_BODY_PX;
      const numbers = isFar ? bodiesOfKind.far : bodiesOfKind.near;
      const at = numbers.more(BODY_NUMBERS);
      numbers.values.set(position, at);
      numbers.values.set(quaternion ?? [1, 0, 0, 0], at + 3);
      numbers.values.set(colour, at + 7);
      numbers.values[at + 10] = opacity;
      numbers.values[at + 11] = scale_m;
    }

    /*
     * Adds a text.
     *
     * shift: right and down from its position, in pixels. Labels that would cover each other move a
     * little up or down, or are left out; one that isStrong is always there. isQuiet: small and grey.
     */
    label(position, text, { colour = null, shift = [0, -26], isQuiet = false, isStrong = false } = {}) {
      this._labels.push({ position, text, colour, shift, isQuiet, isStrong });
    }

    /* Returns how many CSS pixels a metre takes at a position. */
    _pixelsPerMetreAt(position) {
      const away_m = Math.hypot(...minus(position, this._eye)) || 1;
      const near = this.camera.distance_m / away_m;
      return this.camera.pixelsPerMetre(this._height_px) * near;
    }

    /* Returns where a position is in the picture, in CSS pixels; null behind the camera. */
    project(position) {
      const m = this._matrix;
      const [x, y, z] = position;
      const w = m[3] * x + m[7] * y + m[11] * z + m[15];
      if (w <= 0) return null;
      const right = (m[0] * x + m[4] * y + m[8] * z + m[12]) / w;
      const up = (m[1] * x + m[5] * y + m[9] * z + m[13]) / w;
      return [
        ((right + 1) / 2) * this._width_px,
        ((1 - up) / 2) * this._height_px,
        w,
      ];
    }

    /* Draws what was added since `begin`. */
    end() {
      const context = this._context;
      context.setTransform(this._ratio, 0, 0, this._ratio, 0, 0);
      context.clearRect(0, 0, this._overlay.width, this._overlay.height);

      if (this._gpu && !this._gl.isContextLost()) {
        this._gpu.begin(Covey.rgb(Covey.colour("scene")));
        this._gpu.drawPictures(this._matrix, this._pictures);
        this._gpu.draw(this._matrix, this._ratio, this._lines, this._solid, this._ghosts);
      } else {
        this._drawFlat();
      }
      this._drawLabels();
      if (this._credit) this._drawCredit();
    }

    _drawCredit() {
      const context = this._context;
      context.font = "500 11px system-ui, sans-serif";
      context.textAlign = "right";
      context.textBaseline = "bottom";
      context.lineWidth = 4;
      context.strokeStyle = Covey.colour("scene");
      context.fillStyle = Covey.colour("soft");
      const right = this._width_px - CREDIT_MARGIN_PX;
      const bottom = this._height_px - CREDIT_MARGIN_PX;
      context.strokeText(this._credit, right, bottom);
      context.fillText(this._credit, right, bottom);
    }

    // -- without WebGL2 ------------------------------------------------------------------------------

    _drawFlat() {
      const context = this._context;
      const style = ([red, green, blue], opacity) => {
        const parts = [red, green, blue].map((share) => Math.round(255 * share));
        return `rgb(${parts.join(" ")} / ${opacity})`;
      };

      const lines = this._lines.written;
      for (let at = 0; at < lines.length; at += LINE_NUMBERS) {
        const begin = this.project(lines.subarray(at, at + 3));
        const end = this.project(lines.subarray(at + 4, at + 7));
        if (!begin || !end) continue;
        context.strokeStyle = style(lines.subarray(at + 8, at + 11), lines[at + 7]);
        context.lineWidth = lines[at + 3];
        context.beginPath();
        context.moveTo(begin[0], begin[1]);
        context.lineTo(end[0], end[1]);
        context.stroke();
      }

      for (const { written } of [
        this._ghosts.far, this._ghosts.near, this._solid.far, this._solid.near,
      ]) {
        for (let at = 0; at < written.length; at += BODY_NUMBERS) {
          const middle = this.project(written.subarray(at, at + 3));
          if (!middle) continue;
          context.fillStyle = style(written.subarray(at + 7, at + 10), written[at + 10]);
          context.beginPath();
          context.arc(middle[0], middle[1], MIN_BODY_PX / 2, 0, 2 * Math.PI);
          context.fill();
        }
      }
    }

    // -- labels --------------------------------------------------------------------------------------

    _drawLabels() {
      const taken = []; // boxes of labels that are drawn
      const inOrder = [...this._labels].sort(
        (a, b) => a.isQuiet - b.isQuiet || b.isStrong - a.isStrong,
      );
      for (const label of inOrder) {
        const point = this.project(label.position);
        if (!point) continue;

        const writing = this._writings.of(label, this._ratio);
        const middle = [point[0] + label.shift[0], point[1] + label.shift[1]];
        const { width_px, height_px } = writing;
        const sidesteps = label.isQuiet ? [0] : SIDESTEPS;
        let box = freeBox(middle, width_px, height_px, taken, sidesteps);
        if (!box && label.isStrong) box = boxAround(middle, width_px, height_px);
        if (!box) continue;
        taken.push(box);
        this._drawWriting(writing, (box[0] + box[2]) / 2, (box[1] + box[3]) / 2);
      }
    }

    /* Draws a label's text with its middle here, on whole pixels of the screen: it stays sharp. */
    _drawWriting({ image }, x, y) {
      const ratio = this._ratio;
      const left = Math.round(x * ratio - image.width / 2) / ratio;
      const top = Math.round(y * ratio - image.height / 2) / ratio;
      this._context.drawImage(image, left, top, image.width / ratio, image.height / ratio);
    }
  }

  /*
   * Texts of labels as pictures, kept from one picture of the scene to the next: where no graphics
   * card draws, a hundred texts with their halos would be a quarter of a picture's work.
   */
  class Writings {
    constructor() {
      this._kept = new Map(); // what distinguishes a text -> its picture and its size
    }

    /* Returns the picture of a label's text, and the size of the text in CSS pixels. */
    of(label, ratio) {
      const halo = Covey.colour("scene");
      const ordinary = Covey.colour(label.isQuiet ? "soft" : "text");
      const size_px = label.isQuiet ? 11 : 13;
      const style = {
        font: `${label.isStrong ? 700 : 500} ${size_px}px system-ui, sans-serif`,
        colour: label.colour ?? ordinary,
        halo,
        ratio,
      };
      const key = [label.text, ...Object.values(style)].join("\n");
      if (!this._kept.has(key)) {
        if (this._kept.size >= MAX_WRITINGS) this._kept.clear();
        this._kept.set(key, writing(label.text, size_px, style));
      }
      return this._kept.get(key);
    }
  }

  function writing(text, size_px, { font, colour, halo, ratio }) {
    const image = document.createElement("canvas");
    const context = image.getContext("2d");
    context.font = font;
    const width_px = context.measureText(text).width + 4;
    const height_px = size_px + 3;

    image.width = Math.ceil((width_px + HALO_PX) * ratio);
    image.height = Math.ceil((height_px + HALO_PX) * ratio);
    context.setTransform(ratio, 0, 0, ratio, image.width / 2, image.height / 2);
    context.font = font;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    context.lineWidth = HALO_PX;
    context.strokeStyle = halo;
    context.strokeText(text, 0, 0);
    context.fillStyle = colour;
    context.fillText(text, 0, 0);
    return { image, width_px, height_px };
  }

  const SIDESTEPS = [0, -1, 1]; // up and down, in heights of a label

  /* Returns the box of a label that overlaps with none of the others; null where none is free. */
  function freeBox(middle, width_px, height_px, taken, sidesteps) {
    for (const step of sidesteps) {
      const box = boxAround([middle[0], middle[1] + step * height_px], width_px, height_px);
      const isFree = taken.every(
        (other) =>
          box[0] > other[2] || box[2] < other[0] || box[1] > other[3] || box[3] < other[1],
      );
      if (isFree) return box;
    }
    return null;
  }

  /* Returns left, top, right and bottom. */
  function boxAround([x, y], width_px, height_px) {
    return [x - width_px / 2, y - height_px / 2, x + width_px / 2, y + height_px / 2];
  }

  /* Returns 1, 2 or 5 times a power of ten, not below a value. */
  function niceStep(least) {
    const power = 10 ** Math.floor(Math.log10(Math.max(least, 1e-6)));
    for (const factor of [1, 2, 5]) {
      if (factor * power >= least) return factor * power;
    }
    return 10 * power;
  }

  function metres(value) {
    return String(Number(value.toFixed(3))).replace("-", "−");
  }

  // -- WebGL2 ----------------------------------------------------------------------------------------

  const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

  /*
   * Returns whether a graphics card draws, and not the processor. For a processor the smooth edges of
   * bodies would be more work than all the rest.
   */
  function hasGraphicsCard() {
    const gl = document.createElement("canvas").getContext("webgl2");
    if (!gl) return false;

    const names = gl.getExtension("WEBGL_debug_renderer_info");
    const renderer = gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    gl.getExtension("WEBGL_lose_context")?.loseContext(); // a browser has only a few contexts
    return !SOFTWARE.test(renderer);
  }

  class Drawer {
    constructor(gl) {
      this._gl = gl;

      this._lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
      this._lineArray = gl.createVertexArray(); // without attributes
      this._rectangles = gl.createBuffer(); // the corners of each rectangle's triangles
      this._mostRectangles = 0; // that the buffer holds
      this._lineTexture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, this._lineTexture);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
        gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
      }

      this._bodyProgram = program(gl, BODY_VERTEX, BODY_FRAGMENT);
      this._shapes = {
        near: this._shape(quadrotor()),
        far: this._shape(quadrotor({ isSimple: true })),
      };

      this._pictureProgram = program(gl, PICTURE_VERTEX, PICTURE_FRAGMENT);
      this._onCard = new Map(); // image -> its texture and its corners
    }

    /* Brings a body's triangles to the graphics card, with a buffer for the bodies of this shape. */
    _shape(triangles) {
      const buffer = this._gl.createBuffer();
      const array = this._array(triangles, [3, 3, 1], buffer, [3, 4, 4, 1]);
      return { buffer, array, corners: triangles.length / 7 };
    }

    /* Returns a vertex array: a shape, and numbers for each of its instances. */
    _array(shape, shapeSizes, instanceBuffer, instanceSizes) {
      const gl = this._gl;
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);

      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, shape, gl.STATIC_DRAW);
      const next = this._attributes(0, shapeSizes, 0);

      gl.bindBuffer(gl.ARRAY_BUFFER, instanceBuffer);
      this._attributes(next, instanceSizes, 1);
      gl.bindVertexArray(null);
      return array;
    }

    _attributes(location, sizes, divisor) {
      const gl = this._gl;
      const stride = 4 * sizes.reduce((sum, size) => sum + size, 0);
      let offset = 0;
      for (const size of sizes) {
        gl.enableVertexAttribArray(location);
        gl.vertexAttribPointer(location, size, gl.FLOAT, false, stride, offset);
        gl.vertexAttribDivisor(location, divisor);
        offset += 4 * size;
        location += 1;
      }
      return location;
    }

    /* Begins a picture on a background of this colour. */
    begin([red, green, blue]) {
      const gl = this._gl;
      gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
      gl.clearColor(red, green, blue, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.enable(gl.BLEND);
      gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    }

    /* Draws pictures, which hide nothing. */
    drawPictures(matrix, pictures) {
      if (!pictures.length) return;
      const gl = this._gl;
      gl.depthMask(false);
      gl.useProgram(this._pictureProgram.program);
      gl.uniformMatrix4fv(this._pictureProgram.matrix, false, matrix);
      gl.uniform1f(this._pictureProgram.opacity, PICTURE_OPACITY);
      for (const { image, corners } of pictures) {
        if (!this._onCard.has(image)) this._onCard.set(image, this._pictureOf(image, corners));
        const { texture, array } = this._onCard.get(image);
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.bindVertexArray(array);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      }
      gl.depthMask(true);
    }

    /* Brings a picture to the graphics card, once. */
    _pictureOf(image, corners) {
      const gl = this._gl;
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);

      const shares = [[0, 0], [1, 0], [0, 1], [1, 1]];
      const numbers = corners.flatMap((corner, index) => [...corner, ...shares[index]]);
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STATIC_DRAW);
      this._attributes(0, [3, 2], 0);
      gl.bindVertexArray(null);
      return { texture, array };
    }

    draw(matrix, ratio, lines, solid, ghosts) {
      const gl = this._gl;
      const [width_px, height_px] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
      this._drawBodies(matrix, solid);

      // Lines and ghosts hide nothing: what is behind them is seen through them.
      gl.depthMask(false);
      gl.useProgram(this._lineProgram.program);
      gl.uniformMatrix4fv(this._lineProgram.matrix, false, matrix);
      gl.uniform2f(this._lineProgram.size_px, width_px / ratio, height_px / ratio);
      gl.bindVertexArray(this._lineArray);
      gl.bindTexture(gl.TEXTURE_2D, this._lineTexture);
      const numbers = lines.wholeRows(LINES_A_ROW * LINE_NUMBERS);
      const [columns, rows] = [LINES_A_ROW * LINE_TEXELS, numbers.length / (LINES_A_ROW * LINE_NUMBERS)];
      gl.texImage2D(
        gl.TEXTURE_2D, 0, gl.RGBA32F, columns, rows, 0, gl.RGBA, gl.FLOAT, numbers);
      this._drawRectangles(lines.length / LINE_NUMBERS);

      this._drawBodies(matrix, ghosts);
      gl.depthMask(true);
    }

    /* Draws so many rectangles, each of two triangles that share two of its four corners. */
    _drawRectangles(count) {
      const gl = this._gl;
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this._rectangles);
      if (count > this._mostRectangles) {
        this._mostRectangles = 2 * count;
        const corners = Uint32Array.from(
          { length: 6 * this._mostRectangles },
          (_, index) => 4 * Math.floor(index / 6) + RECTANGLE[index % 6],
        );
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
      }
      gl.drawElements(gl.TRIANGLES, 6 * count, gl.UNSIGNED_INT, 0);
    }

    _drawBodies(matrix, bodies) {
      const gl = this._gl;
      gl.useProgram(this._bodyProgram.program);
      gl.uniformMatrix4fv(this._bodyProgram.matrix, false, matrix);
      for (const name of SHAPES) {
        const shape = this._shapes[name];
        const numbers = bodies[name];
        gl.bindVertexArray(shape.array);
        gl.bindBuffer(gl.ARRAY_BUFFER, shape.buffer);
        gl.bufferData(gl.ARRAY_BUFFER, numbers.written, gl.DYNAMIC_DRAW);
        gl.drawArraysInstanced(gl.TRIANGLES, 0, shape.corners, numbers.length / BODY_NUMBERS);
      }
    }
  }

  function program(gl, vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`the scene's program cannot be linked: ${gl.getProgramInfoLog(made)}`);
    }
    return {
      program: made,
      matrix: gl.getUniformLocation(made, "matrix"),
      size_px: gl.getUniformLocation(made, "size_px"),
      opacity: gl.getUniformLocation(made, "opacity"),
    };
  }

  Object.assign(Covey, { Scene, niceStep, freeBox, quadrotor });
})();
