/*
 * Pictures of the ground below a scene, and who made them.
 *
 * The page names for each picture where it is (its own server, or itself) and where its corners lie:
 * north-west, north-east, south-west, south-east. One that does not come is left out.
 */
"use strict";

globalThis.Covey ??= {};

(() => {
  const BELOW_M = 0.02; // the grid lies above it

  class Ground {
    /* ground: as the page has it, or null; onChange is called when a picture has come. */
    constructor(ground, onChange) {
      this._attribution = ground?.attribution ?? "";
      this._pictures = [];
      for (const tile of ground?.tiles ?? []) {
        const image = new Image();
        const corners = tile.corners_enu_m.map(([east, north]) => [east, north, -BELOW_M]);
        image.addEventListener("load", () => {
          this._pictures.push({ image, corners });
          onChange();
        });
        image.src = tile.source;
      }
    }

    draw(scene) {
      for (const { image, corners } of this._pictures) scene.picture(image, corners);
      if (this._pictures.length) scene.credit(this._attribution);
    }
  }

  Object.assign(Covey, { Ground });
})();
