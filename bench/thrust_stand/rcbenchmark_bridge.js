/* Bridge between saranga-bench and the RCbenchmark application, for Series 1520, 1580, 1585 and 1780.

   What it is: a script for the application's own "Scripts" tab. It sends every reading of the stand as one JSON
   datagram and takes throttle commands as JSON datagrams, through the application's documented script interface
   (rcb.udp, rcb.sensors, rcb.output). The stand's own serial protocol is not touched.

   How to use it
     1. Set the safety cutoffs of the application first. They stay in force and are the last line of defence.
     2. Adjust the four lines below. BENCH_IP is the computer that runs saranga-bench.
     3. Paste it into the Scripts tab, run it, then:
          saranga-bench stand check "rcbenchmark+udp://IP-OF-THIS-COMPUTER:55047?listen=64126"

   Dead man: every throttle command carries a deadline in milliseconds, at most LONGEST_MS here. When it passes without
   another command the ESC is set to IDLE_US. It needs this application to be alive: keep a hardware kill in reach.

   Datagrams, 8-bit text
     in   {"do":"hello"}
          {"do":"throttle","us":1150,"token":7,"deadline_ms":200}
          {"do":"tare","id":1}
     out  {"saranga":1,"hello":{"board":"Series 1520","firmware":"...","bridge":1,"longest_ms":2000}}
          {"saranga":1,"n":12,"us":1150,"token":7,"sensors":{"thrust":{"value":12.3,"unit":"g"},...}}
          {"saranga":1,"tared":1}
          {"saranga":1,"error":"..."}                                                                              */

var RECEIVE_PORT = 55047;       // saranga-bench sends here
var BENCH_IP = "127.0.0.1";     // where saranga-bench runs
var BENCH_PORT = 64126;         // its option "listen"
var ESC = "esc";                // "escA" on a Series 1780

var IDLE_US = 1000;
var FULL_US = 2000;
var LONGEST_MS = 2000;
var SAMPLES = 2;                // averaged by the application for one reading

var applied_us = IDLE_US;
var token = 0;
var count = 0;
var taring = false;
var dead_man = null;

rcb.console.setVerbose(false);
rcb.output.set(ESC, IDLE_US);
rcb.udp.init(RECEIVE_PORT, BENCH_IP, BENCH_PORT, function () {
    rcb.udp.onReceive(received);
    say({hello: identity()});
    read();
});

function identity() {
    return {board: String(rcb.getBoardVersion()), firmware: String(rcb.getFirmwareVersion()), bridge: 1,
            longest_ms: LONGEST_MS, idle_us: IDLE_US, full_us: FULL_US};
}

function say(what) {
    what.saranga = 1;
    rcb.udp.send(rcb.udp.str2ab(JSON.stringify(what)));
}

function read() {
    rcb.sensors.read(function (result) {
        var sensors = {};
        for (var key in result) {
            var entry = result[key];
            if (entry && typeof entry.workingValue === "number" && isFinite(entry.workingValue)) {
                sensors[key] = {value: entry.workingValue, unit: String(entry.workingUnit || "")};
            }
        }
        count += 1;
        say({n: count, us: applied_us, token: token, sensors: sensors});
        read();
    }, SAMPLES);
}

function idle() {
    if (dead_man !== null) { clearTimeout(dead_man); dead_man = null; }
    applied_us = IDLE_US;
    token = 0;
    rcb.output.set(ESC, IDLE_US);
}

function received(buffer) {
    var message;
    try { message = JSON.parse(rcb.udp.ab2str(buffer)); } catch (error) { return say({error: "not JSON"}); }
    if (message === null || typeof message !== "object") { return say({error: "not an object"}); }
    if (message.do === "hello") { return say({hello: identity()}); }
    if (message.do === "throttle") { return throttle(message); }
    if (message.do === "tare") {
        if (applied_us > IDLE_US) { return say({error: "tare: the motor turns"}); }
        if (taring) { return say({error: "tare: in progress"}); }
        taring = true;
        return rcb.sensors.tareLoadCells(function () { taring = false; say({tared: message.id}); });
    }
    return say({error: "unknown request"});
}

function throttle(message) {
    var us = message.us, deadline_ms = message.deadline_ms;
    if (typeof us !== "number" || !(us >= IDLE_US && us <= FULL_US) ||
        typeof deadline_ms !== "number" || !(deadline_ms > 0 && deadline_ms <= LONGEST_MS)) {
        idle();                 // what cannot be understood is no reason to go on spinning
        return say({error: "throttle: out of limits"});
    }
    if (dead_man !== null) { clearTimeout(dead_man); }
    dead_man = setTimeout(function () { dead_man = null; idle(); }, deadline_ms);
    applied_us = us;
    token = message.token;
    rcb.output.set(ESC, us);
}
