// The scale of colours beside what is coloured by a number.
import { colourOf } from "./parts.js";

const SVG = "http://www.w3.org/2000/svg";

export function key(place, low, high, colour = colourOf) {
  const svg = document.createElementNS(SVG, "svg");
  const put = (name, attributes, text = "") => {
    const one = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([attribute, value]) => one.setAttribute(attribute, value));
    one.textContent = text;
    svg.append(one);
  };
  const about = { viewBox: "0 0 240 34", width: 240, height: 34, role: "img", "aria-label": `Colours from ${low} to ${high}` };
  Object.entries(about).forEach(([attribute, value]) => svg.setAttribute(attribute, value));
  for (let k = 0; k < 24; k++) put("rect", { x: 10 * k, y: 0, width: 10.5, height: 14, fill: `rgb(${colour((k + 0.5) / 24).join(",")})` });
  put("text", { x: 0, y: 30, "font-size": 12, fill: "currentColor" }, low);
  put("text", { x: 240, y: 30, "font-size": 12, fill: "currentColor", "text-anchor": "end" }, high);
  place.replaceChildren(svg);
}
