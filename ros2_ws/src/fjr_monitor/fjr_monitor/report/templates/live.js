// SPDX-License-Identifier: Apache-2.0
// Shows the running loop of `fjr watch --browser`: events with the scene of the URDF and views (watch/state.py).
"use strict";
(() => {
  const [FACTORS, VISIBLE, DECADES] = [[1, 2, 5, 10, 20, 50, 100, 200, 500, 1000], 0.3, 3]; // as in report/shown.py
  const [AROUND, SILENT] = [0.6, 1.0]; // rad or m about the first position that the picture includes; s
  const LEVELS = ["ok", "maybe", "no", "maybe"];
  const section = document.getElementById("arm");
  const part = (name) => section.querySelector(`.${name}`);
  const stretch = part("stretch");
  let [scene, arm, view, frame, largest, chosen] = [null, null, null, null, 0, false];

  const factor = () => Number((10 ** (DECADES * Number(stretch.value))).toPrecision(2));
  const by = (value) => Object.fromEntries(view.joints.map((joint) => [joint.name, value(joint)]));
  const known = (positions) => (Object.values(positions).every(Number.isFinite) ? positions : null);
  const sum = (first, second) => (first == null || second == null ? NaN : first + second);

  // Magnify as much as the largest deflection so far permits, unless the slider was moved.
  function magnify() {
    largest = Math.max(largest, ...view.joints.map(({ deflection }) => Math.abs(deflection ?? 0)));
    const fitting = FACTORS.filter((each) => each * largest <= VISIBLE);
    if (!chosen) stretch.value = Math.log10(largest && fitting.length ? fitting[fitting.length - 1] : 1) / DECADES;
    part("factor").textContent = `deflection ×${factor()}`;
  }

  function build() {
    part("stage").replaceChildren();
    section.querySelectorAll(".note").forEach((note) => note.remove());
    for (const note of scene.notes) element("p", section, note, "caption note");
    const names = view.joints.map(({ name }) => name);
    arm = Arm.create(part("stage"), { scene, joints: names, ghosts: { reference: "c3", motor: "c2" } });
    const now = by(({ position }) => position ?? 0);
    const moved = (name, way) => ({ ...now, [name]: now[name] + way * AROUND });
    arm?.fit([now, ...names.flatMap((name) => [moved(name, 1), moved(name, -1)])]);
  }

  function pose() {
    magnify();
    const link = known(by(({ position }) => position ?? NaN));
    if (!link) return;
    const reference = known(by(({ position, error }) => sum(position, error == null ? null : -error)));
    const motor = known(by(({ position, deflection }) => sum(position, deflection == null ? null : factor() * deflection)));
    arm.pose("link", link);
    arm.pose("reference", part("reference").checked ? reference : null);
    arm.pose("motor", part("motor").checked ? motor : null);
    arm.draw();
    section.dataset.poses = Number(section.dataset.poses ?? 0) + 1;
  }

  function element(kind, parent, text, name = "") {
    const made = document.createElement(kind);
    made.textContent = text;
    made.className = name;
    return parent.appendChild(made);
  }

  function written(value, unit, digits = 4) {
    return value == null ? "–" : `${value.toFixed(digits)} ${unit}`;
  }

  function thousandths(value, unit) {
    return value == null ? "–" : `${Number((1e3 * value).toPrecision(3))} ${unit}`;
  }

  function percent(share) {
    const whole = Math.round(100 * share);
    const bound = share > 0 && share < 1 ? { 0: "< 1", 100: "> 99" }[whole] : undefined; // only 0 and 1 read 0 and 100
    return `${bound ?? whole} %`;
  }

  function tabulate() {
    const body = document.getElementById("joints");
    body.replaceChildren();
    for (const joint of view.joints) {
      const [length, small, force] = joint.prismatic ? ["m", "mm", "N"] : ["rad", "mrad", "N m"];
      const row = element("tr", body, "");
      element("th", row, joint.name);
      element("td", row, written(joint.position, length));
      element("td", row, thousandths(joint.deflection, small));
      element("td", row, thousandths(joint.error, small));
      element("td", row, written(joint.effort, force, 2));
      const share = joint.limit && joint.effort != null ? Math.abs(joint.effort) / joint.limit : null;
      element("td", row, share == null ? "–" : percent(share));
    }
  }

  function report() {
    const { silence, timing, health } = view;
    const rate = timing ? `${timing.rate.toFixed(1)} states/s` : "";
    const silent = silence == null ? "waiting for joint states" : `no state for ${silence.toFixed(1)} s`;
    document.getElementById("timing").textContent = silence == null || silence > SILENT ? silent : rate;
    const list = document.getElementById("health");
    list.replaceChildren();
    for (const { name, level, state, message } of health) {
      const line = element("li", list, "");
      element("b", line, name, LEVELS[level] ?? "no");
      line.append(` ${state ? `[${state}] ` : ""}${message}`);
    }
  }

  function show() {
    frame = null;
    report();
    tabulate();
    if (!scene || scene.error || !view.joints.length) return;
    if (!arm && !part("stage").classList.contains("unavailable")) build();
    if (arm) pose();
  }

  stretch.oninput = () => (chosen = true);
  const events = new EventSource("/events");
  events.addEventListener("scene", ({ data }) => {
    scene = data ? JSON.parse(data) : null;
    arm = null;
    if (scene?.error) part("stage").textContent = `no arm: ${scene.error}`;
  });
  // One frame for however many views have arrived: drawn one by one, they would wait behind a slow graphics card.
  events.addEventListener("view", ({ data }) => {
    view = JSON.parse(data);
    frame ??= requestAnimationFrame(show);
  });
  events.addEventListener("end", () => {
    events.close();
    cancelAnimationFrame(frame);
    document.getElementById("timing").textContent = "fjr watch has ended";
  });
})();
