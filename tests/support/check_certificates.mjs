// Reads a page with a checker and a JSON list of certificates as texts; prints the answers of the checker as JSON.
import { readFileSync } from "node:fs";
import vm from "node:vm";

const [, script] = readFileSync(process.argv[2], "utf8").match(/<script>([^]*)<\/script>/);
const check = vm.runInThisContext(`${script}\ncheck`);
console.log(JSON.stringify(JSON.parse(readFileSync(0, "utf8")).map((text) => check(text))));
