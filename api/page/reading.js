// Reading options, in words.

export const OPTIONS = {
  quantity: {
    label: "The values are", asIs: "what the file says",
    values: [["brdf", "f_r, the BRDF"], ["ccbrdf", "f_r cos θ_o (cosine-corrected, DSF)"], ["reflectance_factor", "π f_r (reflectance factor)"]],
  },
  convention: {
    label: "Convention", asIs: "the format's own",
    values: [
      ["phi_specular_180", "mirror at φ_o − φ_i = 180°"], ["phi_specular_0", "mirror at φ_o − φ_i = 0°"],
      ["forward", "in-plane: same sign is the specular side"], ["back", "in-plane: same sign is the light's side"],
      ["center", "MERL: values at the centres of cells"], ["corner", "MERL: values at the corners of cells"],
    ],
  },
  negatives: { label: "Negative values", asIs: "by default, masked", values: [["mask", "masked"], ["keep", "used"]] },
  duplicates: { label: "Repeated geometries", asIs: "by default, masked", values: [["mask", "masked"], ["keep", "used"]] },
  fills: { label: "Fill values", asIs: "by default, masked", values: [["mask", "masked"], ["keep", "used"], ["floors", "masked, repeated lowest values too"]] },
};

export const inWords = (name, value) => OPTIONS[name].values.find(([given]) => given === value)?.[1] || value;
