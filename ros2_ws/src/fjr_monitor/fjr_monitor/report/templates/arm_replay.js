// SPDX-License-Identifier: Apache-2.0
// Replays a run in 3D (report/shown.py): play, scrub, or follow the cursor of the plots, which follows the replay.
"use strict";
(() => {
  const { arrays, arm } = JSON.parse(document.getElementById("plots").textContent);
  const section = document.getElementById("arm");
  const part = (name) => section.querySelector(`.${name}`);
  const [DECADES, TICK] = [3, 1000 / 30]; // magnifications from 1 to 10^3; ms between two pictures

  // Decode array number `place` (class Pool in report/html.py).
  function numbers(place) {
    const [kind, count, text] = arrays[place].split(":");
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const values = kind === "d" ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
    return values.length < Number(count) ? new Float64Array(Number(count)).fill(values[0]) : values;
  }

  const times = numbers(arm.t);
  const motion = {};
  for (const [name, columns] of Object.entries(arm.motion)) motion[name] = columns.map(numbers);
  const end = times[times.length - 1];

  // Return the positions at a time by joint, linear between frames; null if one is not known.
  function positions(name, time) {
    let [low, high] = [0, times.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle;
    }
    const share = high > low ? Math.min(1, Math.max(0, (time - times[low]) / (times[high] - times[low]))) : 0;
    const found = motion[name].map((values) => values[low] + share * (values[high] - values[low]));
    return found.every(Number.isFinite) ? Object.fromEntries(arm.joints.map((joint, j) => [joint, found[j]])) : null;
  }

  // Return the motor side with the deflections of the springs magnified: q_l + factor (q_m - q_l).
  function magnified(link, motor, factor) {
    if (!link || !motor) return null;
    return Object.fromEntries(arm.joints.map((joint) => [joint, link[joint] + factor * (motor[joint] - link[joint])]));
  }

  const ghosts = {};
  if (motion.reference) ghosts.reference = "c3";
  if (motion.motor) ghosts.motor = "c2";
  const view = Arm.create(part("stage"), { scene: arm.scene, joints: arm.joints, ghosts });
  if (!view) {
    section.querySelectorAll(".controls").forEach((each) => each.remove());
    return;
  }

  const [slider, output, button, speed, stretch] = ["time", "now", "play", "speed", "stretch"].map(part);
  const shown = { reference: part("reference"), motor: part("motor") };
  const digits = end < 10 ? 3 : 2;
  let [now, playing] = [0, null];

  const factor = () => Number((10 ** (DECADES * Number(stretch.value))).toPrecision(2));

  function show() {
    const link = positions("link", now);
    view.pose("link", link);
    if (motion.reference) view.pose("reference", shown.reference.checked ? positions("reference", now) : null);
    if (motion.motor) {
      view.pose("motor", shown.motor.checked ? magnified(link, positions("motor", now), factor()) : null);
      part("factor").textContent = `deflection ×${factor()}`;
    }
    view.draw();
    slider.value = now;
    output.textContent = `${now.toFixed(digits)} s`;
    section.dataset.time = now;
  }

  function go(time) {
    now = Math.min(end, Math.max(times[0], time));
    show();
    document.dispatchEvent(new CustomEvent("arm-time", { detail: now }));
  }

  function stop() {
    cancelAnimationFrame(playing?.request);
    playing = null;
    button.textContent = "▶";
    button.ariaLabel = "play";
  }

  function play() {
    if (now >= end) now = times[0];
    playing = { request: 0, last: performance.now() };
    button.textContent = "❚❚";
    button.ariaLabel = "pause";
    playing.request = requestAnimationFrame(step);
  }

  function step(stamp) {
    if (!playing) return;
    if (stamp - playing.last >= TICK) {
      go(now + (1e-3 * (stamp - playing.last)) * Number(speed.value));
      playing.last = stamp;
      if (now >= end) return stop();
    }
    playing.request = requestAnimationFrame(step);
  }

  slider.min = times[0];
  slider.max = end;
  stretch.value = Math.log10(arm.magnification) / DECADES;
  for (const name of ["reference", "motor"]) part(`of-${name}`).hidden = !motion[name];
  button.onclick = () => (playing ? stop() : play());
  slider.oninput = () => go(Number(slider.value));
  for (const input of [stretch, ...Object.values(shown)]) input.oninput = show;
  document.addEventListener("plot-time", ({ detail }) => {
    if (playing) return;
    now = Math.min(end, Math.max(times[0], detail));
    show();
  });
  view.fit(Array.from(times, (time) => positions("link", time)).filter(Boolean));
  show();
})();
