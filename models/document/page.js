"use strict";
// Shows the curve under the pointer with its values and units. The page is complete without this script.
(() => {
  const NEAR = 16; // largest distance of the pointer from a point, in a panel's units
  const FINE = 100; // paths are written in 1 / FINE of a unit
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  tip.setAttribute("aria-hidden", "true"); // every figure has a text alternative, and tables have the numbers
  document.body.append(tip);
  const spot = document.createElementNS("http://www.w3.org/2000/svg", "circle");
  spot.setAttribute("class", "spot");
  spot.setAttribute("r", "5");

  // Returns the points of a path: all points of a line, or the centres of markers.
  function points(path) {
    const found = [];
    const markers = path.classList.contains("point");
    let x = 0, y = 0;
    for (const [, command, text] of path.getAttribute("d").matchAll(/([a-z])([^a-z]*)/gi)) {
      const numbers = (text.match(/-?\d+/g) || []).map(Number);
      if (command === "M") {
        [x, y] = numbers;
        found.push([x / FINE, y / FINE]);
      } else if (!markers) {
        for (let i = 0; i + 1 < numbers.length; i += 2) {
          x += numbers[i];
          y += numbers[i + 1];
          found.push([x / FINE, y / FINE]);
        }
      }
    }
    return found;
  }

  // Returns a position along an axis, from 0 to 1, as a number with its unit.
  function text(axis, share) {
    const { name, unit, low, high, log, names } = axis;
    const value = log ? low * (high / low) ** share : low + share * (high - low);
    if (names.length) return `${name} ${names[Math.round(value)]}`;
    const shown = !log && Math.abs(value) < (high - low) / 1000 ? 0 : Number(value.toPrecision(3));
    const number = String(shown).replace("-", "−");
    return unit ? `${number} ${unit}` : `${name} ${number}`;
  }

  function hide() {
    tip.hidden = true;
    spot.remove();
    for (const one of document.querySelectorAll(".dim")) one.classList.remove("dim");
    for (const one of document.querySelectorAll(".on")) one.classList.remove("on");
  }

  // Shows the curves of one controller in all panels of a figure, and the others faintly.
  function link(plot, name) {
    const figure = plot.closest(".panels"), whose = name.split(/[,:]/)[0];
    const same = [...figure.querySelectorAll("[data-name]")].filter((one) => one.dataset.name.split(/[,:]/)[0] === whose);
    if (!same.some((one) => one.matches(".line, .point"))) return;
    figure.classList.add("dim");
    for (const one of same) one.classList.add("on");
  }

  for (const plot of document.querySelectorAll("svg.plot")) {
    const { x: across, y: down, area: [left, top, width, height] } = JSON.parse(plot.dataset.axes);
    let curves = null;
    const show = (event) => {
      curves ??= [...plot.querySelectorAll(".line[data-name], .point[data-name]")].map((path) => [path.dataset.name, points(path)]);
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(plot.getScreenCTM().inverse());
      let nearest = NEAR, name = "", x = at.x, y = at.y;
      for (const [whose, all] of curves) {
        for (const [px, py] of all) {
          const away = Math.hypot(px - at.x, py - at.y);
          if (away < nearest && py >= top - 1 && py <= top + height + 1) [nearest, name, x, y] = [away, whose, px, py];
        }
      }
      hide();
      const on = nearest < NEAR;
      name ||= event.target.dataset?.name ?? "";
      if (!name) return;
      link(plot, name);
      const values = [down && text(down, (top + height - y) / height), (on || down) && text(across, (x - left) / width)];
      tip.textContent = `${name}\n${values.filter(Boolean).join(" at ")}`.trim();
      tip.hidden = false;
      const room = document.documentElement.clientWidth - tip.offsetWidth - 8;
      tip.style.left = `${Math.max(4, Math.min(event.clientX + 14, room)) + window.scrollX}px`;
      tip.style.top = `${event.clientY + 16 + window.scrollY}px`;
      if (!on) return spot.remove();
      spot.setAttribute("cx", x);
      spot.setAttribute("cy", y);
      plot.append(spot);
    };
    plot.addEventListener("pointermove", show);
    plot.addEventListener("pointerdown", show);
    plot.addEventListener("pointerleave", hide);
  }
  document.addEventListener("keydown", (event) => event.key === "Escape" && hide());
})();
