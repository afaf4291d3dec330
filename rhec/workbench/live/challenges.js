// Challenges, scored on the fields of the ten seeds by one rule a field.
"use strict";

// Each begins in a scene, on a soil. `free` are the fields of Scenario that may change besides the
// weights Q. `misses` says what else the settings lack; `won` judges a field by the metrics of the
// runs, of which one is followed.
const CHALLENGES = {
  settle: {
    scene: "a",
    soil: "soft",
    free: ["r", "look_ahead_m"],
    task: "On soft soil, bring the followed robot back to its row in less than 15 s without"
      + " crossing it by 0.1 m, on as many fields as you can. You have Q, R and the look-ahead.",
    misses: () => $("soil").value === "soft" ? "" : "The soil must be soft.",
    won: (runs, followed) =>
      runs[followed].settling_time_s < 15 && runs[followed].overshoot_m < 0.1,
  },
  patch: {
    scene: "b",
    soil: "firm",
    free: [],
    task: "On firm soil, place one wet patch on which the EKF's robot goes more than 0.25 m off its"
      + " path, but the RHE's does not.",
    misses: () => $("soil").value !== "firm" ? "The soil must be firm."
      : page.patches.length === 1 ? "" : "There must be one wet patch.",
    won: ([rhe, ekf]) => ekf.max_error_true_m > 0.25 && rhe.max_error_true_m <= 0.25,
  },
  cautious: {
    scene: "yaw_drift",
    soil: "firm",
    free: ["slip_difference"],
    task: "Find a soil on which the cautious robot leaves its row: after it has settled, it is"
      + " more than 0.12 m off on a straight part. You have the kind of soil, “left slips more”,"
      + " and wet patches.",
    misses: () => "",
    won: runs => runs[2].violations_true > 0,
  },
};

const challenge = () => CHALLENGES[$("challenge").value];

// What forbids to count the present settings, in a sentence; "" if nothing does.
function missing({ scene, free, misses }) {
  const begun = page.world.scenes[scene].values;
  const same = (name, value) => free.includes(name) || `${value}` === `${begun[name]}`;
  if (page.scene !== scene) return `The scene must be “${page.world.scenes[scene].title}”.`;
  if (!Object.entries(page.values).every(([name, value]) => same(name, value)))
    return "A slider has moved that this challenge leaves alone; “reset” puts it back.";
  if ($("noise").value !== "calibrated" || $("window").value !== "15")
    return "The noise W must be calibrated, the window of 15 intervals.";
  return misses();
}

function show_score() {
  const chosen = challenge();
  $("task").textContent = chosen?.task ?? "";
  $("score").textContent = chosen ? missing(chosen) : "";
  const own = fields.results.filter(({ noise, soil }) => noise === soil);
  if (!chosen || missing(chosen) || own.length < page.world.seeds.length) return;
  const won = own.sort((one, other) => one.noise - other.noise)
    .map(({ runs }) => chosen.won(runs.map(({ metrics }) => metrics), page.followed));
  const marks = won.map(is_won => is_won ? "✓" : "✗").join(" ");
  $("score").textContent = `${won.filter(Boolean).length} of ${won.length} fields: ${marks}`;
}

$("challenge").onchange = () => {
  const chosen = challenge();
  if (!chosen) return follow_the_controls();
  $("soil").value = chosen.soil;
  return choose(chosen.scene);
};
