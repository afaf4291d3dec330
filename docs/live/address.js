// All that the reader chose, after # in the address, so that a link shows others the same:
// #SCENE?name=value&… of the sandbox, #step-ID?name=value&… of a step of the story.
"use strict";

const SETTINGS = ["seed", "soil", "noise", "window", "fault"]; // the sandbox's lists

const numbers = text => text.split(",").map(Number);

// The value with which a list begins.
const begun = ({ options }) =>
  ([...options].find(({ defaultSelected }) => defaultSelected) ?? options[0]).value;

// The values that differ from those with which the scene begins.
function address_of_sandbox() {
  const { world, scene, values, runs, followed, patches } = page;
  const first = world.scenes[scene];
  const words = new URLSearchParams();
  const put = (name, value, at_first) => {
    if (`${value}` !== `${at_first}`) words.set(name, value);
  };
  for (const id of SETTINGS) put(id, $(id).value, id === "fault" ? first.fault : begun($(id)));
  for (const name in values) put(name, values[name], first.values[name]);
  runs.forEach(({ fields }, i) => {
    for (const name in fields) put(`${i}.${name}`, fields[name], first.runs[i][2][name]);
  });
  put("follow", followed, 0);
  put("patches", patches.map(patch => patch.join(",")).join(";"), "");
  const moment = Number($("moment").value);
  const opened = (first.time_s + 0.1) / first.values.duration_s;
  if (Math.abs(moment - opened) > 0.001) words.set("moment", moment);
  const text = words.toString().replaceAll("%2C", ",").replaceAll("%3B", ";");
  return `#${scene}${text && "?"}${text}`;
}

// Take the values of an address into the scene that was just chosen.
function take_address(words) {
  const { world: { scenes }, values, runs, scene } = page;
  const like = (now, text) => Array.isArray(now) ? numbers(text) : numbers(text)[0];
  const fits = (now, found) => [now].flat().length === [found].flat().length
    && [found].flat().every(Number.isFinite);
  for (const [name, text] of words) {
    const [, run, field] = name.match(/^(\d)\.(\w+)$/) ?? [];
    const into = run ? runs[run]?.fields : values;
    const key = field ?? name;
    if (SETTINGS.includes(name) && [...$(name).options].some(({ value }) => value === text))
      $(name).value = text;
    else if (name === "follow" && runs[text]) page.followed = Number(text);
    else if (name === "patches") page.patches = text.split(";").map(numbers)
      .filter(patch => patch.length === 5 && patch.every(Number.isFinite));
    else if (name === "moment" && isFinite(text)) $("moment").value = text;
    else if (into && Object.hasOwn(into, key) && fits(into[key], like(into[key], text)))
      into[key] = like(into[key], text);
  }
  if (scenes[scene].runs[page.followed]) $("controls")[`run-${scene}`].value = page.followed;
}

function address_of_step({ id, controls, form }) {
  const words = new URLSearchParams();
  for (const name in controls) {
    const now = value_of(form.elements[name]);
    if (now !== controls[name]) words.set(name, now);
  }
  return `#step-${id}${words.size ? "?" : ""}${words}`;
}

function open_step(id, words) {
  const step = story.steps[id];
  for (const [name, text] of words) {
    const field = step.form.elements[name];
    if (!field || name === "next") continue;
    if (field.type === "checkbox") field.checked = text === "true";
    else field.value = "log" in field.dataset ? Math.log10(text) : text;
  }
  want(step);
  story.busy.then(() => step.section.scrollIntoView());
}

// Show what the address asks for. Returns whether it names a scene.
function open_address() {
  const [, name, text] = location.hash.match(/^#([\w-]*)\??(.*)$/) ?? [];
  const words = [...new URLSearchParams(text)];
  const id = name?.replace("step-", "");
  if (name?.startsWith("step-") && Object.hasOwn(story.steps, id)) open_step(id, words);
  if (!name || !Object.hasOwn(page.world?.scenes ?? {}, name)) return false;
  for (const of of SETTINGS) $(of).value = begun($(of));
  choose(name, words);
  (story.busy ?? Promise.resolve()).then(() => $("sandbox").scrollIntoView());
  return true;
}

let write_soon = null; // the address is written when nothing has moved for a moment
function write_address() {
  page.address ??= address_of_sandbox(); // what the page opened with need not be written
  clearTimeout(write_soon);
  write_soon = setTimeout(() => {
    const address = address_of_sandbox();
    if (page.address !== address) history.replaceState(null, "", address);
    page.address = address;
  }, 300);
}

addEventListener("hashchange", open_address);
