// The atlas: which metric of which method, over which two axes; a slider for each of the others.
{
  const { dense, maps } = JSON.parse(document.getElementById("atlas-data").textContent);
  const form = document.getElementById("atlas-controls");
  const table = document.getElementById("atlas-map");
  const said = document.getElementById("atlas-said");
  const made = (name, more = {}, ...inside) => {
    const part = Object.assign(document.createElement(name), more);
    part.append(...inside);
    return part;
  };
  const unique = (values) => [...new Set(values)];
  const choice = (title, values, chosen) => {
    const select = made("select", { name: title });
    for (const value of values) select.append(made("option", { textContent: value, selected: value === chosen }));
    return select;
  };
  const labelled = (title, part) => made("label", {}, title, part);
  let map = maps[0], down = map.axes[0], across = map.axes[1];
  const at = {}; // where the sliders stand, by axis: kept when another map is chosen

  const control = (title, values, chosen, change) => {
    const select = choice(title, values, chosen);
    select.addEventListener("change", () => {
      change(select.value);
      build(title);
    });
    return labelled(title, select);
  };
  const pick = (metric, what) => {
    map = maps.find((m) => m.metric === metric && m.what === what) || maps.find((m) => m.metric === metric);
    if (!map.axes.includes(down)) down = map.axes.find((axis) => axis !== across);
    if (!map.axes.includes(across)) across = map.axes.find((axis) => axis !== down);
  };
  const build = (focused) => {
    const parts = [
      control("Metric", unique(maps.map((m) => m.metric)), map.metric, (value) => pick(value, map.what)),
      control("Method", unique(maps.filter((m) => m.metric === map.metric).map((m) => m.what)), map.what,
        (value) => pick(map.metric, value)),
      control("Down", map.axes, down, (value) => {
        if (value === across) across = down;
        down = value;
      }),
      control("Across", map.axes, across, (value) => {
        if (value === down) down = across;
        across = value;
      }),
    ];
    map.axes.forEach((axis, place) => {
      if (axis === down || axis === across) return;
      const labels = map.labels[place];
      at[axis] = Math.min(at[axis] || 0, labels.length - 1);
      const slider = made("input", { type: "range", min: 0, max: labels.length - 1, step: 1, name: axis });
      slider.value = at[axis];
      const shown = made("span", { textContent: labels[at[axis]] });
      slider.setAttribute("aria-label", axis);
      slider.setAttribute("aria-valuetext", labels[at[axis]]);
      slider.addEventListener("input", () => {
        at[axis] = Number(slider.value);
        shown.textContent = labels[at[axis]];
        slider.setAttribute("aria-valuetext", labels[at[axis]]);
        draw();
      });
      parts.push(labelled(made("span", {}, `${axis} = `, shown), slider));
    });
    form.replaceChildren(...parts);
    if (focused) form.elements[focused].focus();
    draw();
  };
  const draw = () => {
    const place = (axis) => map.axes.indexOf(axis);
    const rows = map.labels[place(down)], columns = map.labels[place(across)];
    const index = (i, j) =>
      map.axes.reduce((n, axis, k) => n * map.labels[k].length + (axis === down ? i : axis === across ? j : at[axis]), 0);
    const cell = (n) => {
      const part = made("td", { textContent: map.text[n], title: map.text[n], className: map.kind[n] });
      part.style.setProperty("--at", map.shade[n]);
      return part;
    };
    const rest = map.axes.filter((axis) => axis !== down && axis !== across)
      .map((axis) => `${axis} = ${map.labels[place(axis)][at[axis]]}`).join(", ");
    const caption = `${map.metric}, ${map.what}: ${down} down, ${across} across` + (rest ? `; ${rest}` : "");
    table.caption.firstChild.textContent = caption;
    table.tHead.rows[0].replaceChildren(made("td"), ...columns.map((c) => made("th", { textContent: c, scope: "col" })));
    table.tBodies[0].replaceChildren(...rows.map((label, i) =>
      made("tr", {}, made("th", { textContent: label, scope: "row" }), ...columns.map((_, j) => cell(index(i, j))))));
    table.className = columns.length >= dense ? "map dense" : "map";
    document.getElementById("atlas-scale").textContent = map.scale;
    if (said.dataset.ready) said.textContent = caption;
    said.dataset.ready = "yes"; // nothing is said of the first map
  };
  form.addEventListener("submit", (event) => event.preventDefault());
  build();
}
