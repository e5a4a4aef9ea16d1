// Scenes of one shape under one kind of light.

export const SHAPES = [["sphere", "sphere"], ["plate", "plate, seen at a slant"]];
export const LIGHTS = [
  ["sun", "sun, from the side"], ["low", "low sun, facing the camera"], ["softbox", "soft box"], ["lamp", "small lamp, near"], ["sky", "even sky"], ["both", "sun and sky"],
];

const SUN = { kind: "directional", direction: [1, -1, 1.5], irradiance: 3.14 };
const SKY = { kind: "environment", radiance: 0.5 };
const OF = {
  sun: [SUN],
  low: [{ kind: "directional", direction: [0, 2, 0.8], irradiance: 3.14 }],
  softbox: [{ kind: "area", center: [2, -2, 3], normal: [-2, 2, -3], size: [2, 2], radiance: 4 }],
  lamp: [{ kind: "point", position: [1.5, -1.2, 1.8], intensity: 12 }],
  sky: [{ kind: "environment", radiance: 1 }],
  both: [SUN, SKY],
};

/** A scene whose one shape is made of `material`. */
export function scene(shape, light, material, channels) {
  const plate = shape === "plate";
  return {
    camera: { position: plate ? [0, -3.4, 1.5] : [0, -4, 1.6], look_at: [0, 0, plate ? -0.1 : 0], fov_deg: 34, width: 160, height: 120 },
    channels,
    materials: { sample: material },
    shapes: [plate ? { kind: "plane", size: [2.4, 2.4], material: "sample" } : { kind: "sphere", radius: 1, material: "sample" }],
    lights: OF[light] || OF.sun,
  };
}
