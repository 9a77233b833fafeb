// What fleet_map.js needs, under the one name that the page's import map has for this folder.
export { readFrame } from "./frame.js";
export { SetLayer } from "./sets.js";
export { drawOverlay } from "./overlay.js";
export { Camera } from "./camera.js";
export { listen } from "./pointer.js";
