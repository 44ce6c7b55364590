// The scale of colours beside what is coloured by a number.
import { colourOf } from "./parts.js";
import { drawn } from "./words.js";

export function key(place, low, high, colour = colourOf) {
  const about = { viewBox: "0 0 240 34", width: 240, height: 34, role: "img", "aria-label": `Colours from ${low} to ${high}` };
  const boxes = Array.from({ length: 24 }, (_, k) => drawn("rect", { x: 10 * k, y: 0, width: 10.5, height: 14, fill: `rgb(${colour((k + 0.5) / 24).join(",")})` }));
  const text = (x, anchor, words) => drawn("text", { x, y: 30, "font-size": 12, fill: "currentColor", "text-anchor": anchor }, words);
  place.replaceChildren(drawn("svg", about, ...boxes, text(0, "start", low), text(240, "end", high)));
}
