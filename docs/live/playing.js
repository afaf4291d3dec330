// Play the run: button, speed, space bar.
"use strict";

const player = { on: false, time_s: 0, stamp: 0, shown: "" };

function play_on(stamp) {
  if (!player.on) return;
  const [loop] = page.loops;
  const moment = $("moment");
  if (loop?.samples) {
    const end_s = loop.samples * page.world.dt_s;
    // Somebody else moved the time, or a scene began: go on from there.
    if (moment.value !== player.shown) player.time_s = moment.value * end_s;
    player.time_s += (stamp - player.stamp) / 1000 * $("pace").value;
    const before = Math.floor(moment.value * loop.samples);
    moment.value = player.time_s / end_s;
    player.shown = moment.value;
    if (Math.floor(moment.value * loop.samples) !== before) ask(draw);
    if (player.time_s >= end_s) play(false);
  }
  player.stamp = stamp;
  requestAnimationFrame(play_on);
}

function play(on) {
  const is_new = on && !player.on;
  player.on = on;
  $("play").textContent = on ? "pause" : "play";
  if (!is_new) return;
  if (Number($("moment").value) > 0.999) $("moment").value = 0;
  player.stamp = performance.now();
  player.shown = "";
  requestAnimationFrame(play_on);
}

$("play").onclick = () => play(!player.on);
document.addEventListener("keydown", event => {
  // The space bar presses buttons, and chooses in lists; elsewhere it plays.
  if (event.key !== " " || event.target.closest("button, select, summary, a, [type=radio]")) return;
  event.preventDefault();
  play(!player.on);
});
