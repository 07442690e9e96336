/* Pages of tasks come before reference, and reference before evidence, lists of pages and single names of Python. */
var Scorer = {
  score: (result) => {
    const [docname, title, anchor, description, score] = result;
    const shelves = [["do/python", 35], ["do/", 40], ["start/", 30], ["lookup/robots/", 10], ["lookup/api/", -30], ["evidence/", -10]];
    const bonus = docname.endsWith("index") ? null : shelves.find(([shelf]) => docname.startsWith(shelf));
    return score + (bonus ? bonus[1] : 0) - 0.1 * title.length; /* of titles alike, the shorter */
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 60,
  partialTitle: 20,
  term: 5,
  partialTerm: 2,
};
