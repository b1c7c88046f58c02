// Draws every figure in the colours of the page, light, dark or on paper, and moves the menu.
(function () {
  "use strict";
  const root = document.documentElement;
  const plots = [...document.querySelectorAll(".plot")];
  const read = (element) => JSON.parse(element.textContent);
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const quiet = { displaylogo: false, responsive: true, displayModeBar: "hover", scrollZoom: false,
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "zoomIn2d", "zoomOut2d"] };

  function template() {
    const ink = colour("--ink"), grid = colour("--grid"), line = colour("--line"), soft = colour("--soft");
    const axis = { gridcolor: grid, linecolor: line, zerolinecolor: soft, zerolinewidth: 1, tickcolor: line, automargin: true };
    const scene = { gridcolor: grid, linecolor: line, zerolinecolor: line, color: soft };
    return { layout: {
      font: { family: getComputedStyle(document.body).fontFamily, size: 12.5, color: ink },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", xaxis: { ...axis, zeroline: false }, yaxis: axis,
      scene: { xaxis: scene, yaxis: scene, zaxis: scene, bgcolor: "rgba(0,0,0,0)" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: grid, activecolor: soft },
      hoverlabel: { bgcolor: colour("--shade"), bordercolor: line, font: { color: ink } },
    } };
  }

  // Means lie on coloured points, the arm among coloured arrows: they take the ink of the page.
  function inked(data) {
    return data.map((trace) => trace.meta === "ink"
      ? { ...trace, line: { ...trace.line, color: colour("--ink") }, marker: { ...trace.marker, color: colour("--ink") } }
      : trace);
  }

  function draw(plot) {
    const made = read(document.querySelector('script[data-for="' + plot.id + '"]'));
    made.layout.template = template();
    Plotly.newPlot(plot, inked(made.data), made.layout, quiet);
    if (plot._fullLayout.scene) { addView(plot, plot._fullLayout.scene.camera); }
  }

  // One notch of plotly's wheel zoom can shrink a scene to a dot: the wheel scrolls the page, buttons zoom.
  function addView(plot, camera) {
    const first = JSON.parse(JSON.stringify(camera));
    const row = document.createElement("div");
    row.className = "view";
    for (const [text, factor] of [["Zoom in", 0.8], ["Zoom out", 1.25], ["Reset view", 0]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.addEventListener("click", () => Plotly.relayout(plot, { "scene.camera": factor ? zoomed(plot, factor) : first }));
      row.append(button);
    }
    plot.after(row);
    plot.addEventListener("wheel", (event) => event.stopPropagation(), { capture: true });
  }

  function zoomed(plot, factor) {
    const { eye, center, up } = plot._fullLayout.scene.camera;
    const nearer = (axis) => center[axis] + factor * (eye[axis] - center[axis]);
    return { up: up, center: center, eye: { x: nearer("x"), y: nearer("y"), z: nearer("z") } };
  }

  function recolour() {
    for (const plot of plots) {
      Plotly.react(plot, inked(plot.data), { ...plot.layout, template: template() }, quiet);
    }
  }

  // The samples of every panel come first in a figure, then the means of the bins of every panel.
  function choose(prefix, entry) {
    const plot = document.getElementById(prefix + "detail");
    const panels = entry.means.map((_, k) => k);
    const means = panels.map((k) => panels.length + k);
    const x = [...panels.map(() => entry.x), ...panels.map(() => entry.centres)];
    Plotly.restyle(plot, { x: x }, [...panels, ...means]);
    Plotly.restyle(plot, { y: entry.means }, means);
    const axis = "xaxis" + (panels.length > 1 ? panels.length : "");
    Plotly.relayout(plot, { [axis + ".title.text"]: entry.label, [axis + ".autorange"]: true });
  }

  function unfoldAll() {
    document.querySelectorAll("details").forEach((group) => { group.open = true; });
  }

  plots.forEach(draw);
  const unfold = document.getElementById("unfold");
  document.querySelectorAll("select.menu").forEach((menu) => {
    const entries = read(document.getElementById(menu.dataset.kind + "against"));
    menu.addEventListener("change", () => choose(menu.dataset.kind, entries[Number(menu.value)]));
  });
  if (unfold) { unfold.addEventListener("click", unfoldAll); }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  window.matchMedia("print").addEventListener("change", recolour);
  window.addEventListener("beforeprint", unfoldAll);
})();
