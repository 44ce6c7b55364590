// Pointing at points that are drawn on a canvas: the nearest one, a click on it, and a box around many.
const NEAR = 9; // pixels within which a point is meant
const STILL = 4; // pixels that a click may move

/**
 * `places()` gives where the points are on the canvas, x and y after one another, NaN of those that are not seen; `boxing(event)`
 * whether dragging draws a box, `hold(whether)` stops and starts what dragging else does.
 */
export function pickable(canvas, { places, hover, click, box, boxing, hold = () => {} }) {
  const frame = Object.assign(document.createElement("div"), { className: "box", hidden: true });
  canvas.after(frame);
  let from = null;
  let drawing = false;

  const where = (event) => {
    const { left, top } = canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  };
  const nearest = ([x, y]) => {
    const all = places();
    let found = -1;
    let least = NEAR ** 2;
    for (let k = 0; k < all.length; k += 2) {
      const distance = (all[k] - x) ** 2 + (all[k + 1] - y) ** 2;
      if (distance < least) [found, least] = [k / 2, distance];
    }
    return found;
  };
  const within = ([ax, ay], [bx, by]) => {
    const all = places();
    const [left, right, top, bottom] = [Math.min(ax, bx), Math.max(ax, bx), Math.min(ay, by), Math.max(ay, by)];
    const found = [];
    for (let k = 0; k < all.length; k += 2) if (all[k] >= left && all[k] <= right && all[k + 1] >= top && all[k + 1] <= bottom) found.push(k / 2);
    return found;
  };
  const outline = ([ax, ay], [bx, by]) => {
    frame.hidden = false;
    frame.style.left = `${canvas.offsetLeft + Math.min(ax, bx)}px`;
    frame.style.top = `${canvas.offsetTop + Math.min(ay, by)}px`;
    frame.style.width = `${Math.abs(bx - ax)}px`;
    frame.style.height = `${Math.abs(by - ay)}px`;
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    from = where(event);
    drawing = boxing(event);
    if (!drawing) return;
    event.stopImmediatePropagation();
    hold(true);
    canvas.setPointerCapture(event.pointerId);
  }, { capture: true });
  canvas.addEventListener("pointermove", (event) => {
    if (from && drawing) outline(from, where(event));
    if (event.buttons) return;
    const found = nearest(where(event));
    canvas.classList.toggle("near", found >= 0);
    hover(found, event);
  });
  canvas.addEventListener("pointerleave", (event) => hover(-1, event));
  canvas.addEventListener("pointerup", (event) => {
    if (!from) return;
    const to = where(event);
    const moved = Math.hypot(to[0] - from[0], to[1] - from[1]);
    const found = moved <= STILL ? nearest(to) : -1;
    if (found >= 0) click(found);
    else if (drawing && moved > STILL) box(within(from, to));
    end();
  });
  canvas.addEventListener("pointercancel", end);

  function end() {
    if (drawing) hold(false);
    frame.hidden = true;
    [from, drawing] = [null, false];
  }
}
