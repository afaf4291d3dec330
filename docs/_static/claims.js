// Filters the cards of claims.html by verdict, section and words. Without it all cards are shown.
"use strict"

{
  const form = document.querySelector(".claim-filter")
  const cards = [...document.querySelectorAll("section.claim")]
  const texts = new Map(cards.map(card => [card, card.textContent.toLowerCase()]))

  function show() {
    const { words, verdict, section } = form.elements
    const wanted = words.value.toLowerCase().split(/\s+/)
    for (const card of cards)
      card.hidden = (verdict.value && card.dataset.verdict != verdict.value) ||
        (section.value && card.dataset.section != section.value) ||
        !wanted.every(word => texts.get(card).includes(word))
    for (const part of new Set(cards.map(card => card.parentElement)))
      part.hidden = !part.querySelector("section.claim:not([hidden])")
    const count = cards.filter(card => !card.hidden).length
    form.querySelector("output").textContent = `${count} of ${cards.length} claims`
  }

  // A link to a card unfolds it, and shows it if the filter hides it.
  function follow() {
    const card = document.getElementById(decodeURIComponent(location.hash.slice(1)))
    if (!cards.includes(card)) return
    card.firstElementChild.open = true
    if (!card.closest("[hidden]")) return
    form.reset()
    show()
    card.scrollIntoView()
  }

  form.addEventListener("input", show)
  form.addEventListener("reset", () => setTimeout(show))
  form.addEventListener("submit", event => event.preventDefault())
  form.elements.unfold.onclick = () => {
    const folded = cards.some(card => !card.hidden && !card.firstElementChild.open)
    for (const card of cards) if (!card.hidden) card.firstElementChild.open = folded
    form.elements.unfold.textContent = folded ? "Fold" : "Unfold"
  }
  addEventListener("hashchange", follow)
  form.hidden = false
  // The bar of verdicts on the first page leads here with the one that was clicked.
  form.elements.verdict.value = new URLSearchParams(location.search).get("verdict") ?? ""
  show()
  follow()
}
