/* Stands in for the RCbenchmark application: runs a script with the rcb interface that it uses, over real UDP.
   node rcbenchmark_application.js SCRIPT RECEIVE_PORT BENCH_PORT; prints every output as a JSON line. */
const dgram = require("dgram"), fs = require("fs"), vm = require("vm");
const [script, receivePort, benchPort] = [process.argv[2], Number(process.argv[3]), Number(process.argv[4])];
let us = 1000, zero = 3.5, receive = null, socket = null, target = null;

const sensor = (value, unit) => ({workingValue: value, workingUnit: unit, displayValue: value, displayUnit: unit});
const rcb = {
    console: {setVerbose() {}, print() {}},
    getBoardVersion: () => "Series 1580", getFirmwareVersion: () => "1.5",
    output: {set(id, value) { us = value; console.log(JSON.stringify({id, us, t_ms: Date.now()})); }},
    udp: {
        init(port, ip, outPort, ready) {
            target = [outPort, ip];
            socket = dgram.createSocket("udp4");
            socket.on("message", m => receive && receive(new Uint8Array(m).buffer));
            socket.bind(port, "127.0.0.1", ready);
        },
        onReceive(callback) { receive = callback; },
        send(buffer) { socket.send(Buffer.from(buffer), ...target); },
        str2ab(text) { return Uint8Array.from(text, c => c.charCodeAt(0)).buffer; },
        ab2str(buffer) { return String.fromCharCode.apply(null, new Uint8Array(buffer)); },
    },
    sensors: {
        read(callback) {
            setTimeout(() => callback({
                thrust: sensor(zero + 0.2 * (us - 1000), "g"), torque: sensor(0.01, "N·m"),
                voltage: sensor(11.1, "V"), current: sensor(0.2, "A"),
                motorElectricalSpeed: sensor(10 * (us - 1000), "RPM"), motorOpticalSpeed: sensor(0, "RPM"),
                vibration: sensor(0.5, "g"), print() {}}), 10);
        },
        tareLoadCells(callback) { zero = 0; setTimeout(callback, 20); },
    },
};
const source = fs.readFileSync(script, "utf8")
    .replace(/RECEIVE_PORT = \d+/, `RECEIVE_PORT = ${receivePort}`).replace(/BENCH_PORT = \d+/, `BENCH_PORT = ${benchPort}`);
vm.runInNewContext(source, {rcb, setTimeout, clearTimeout, JSON, Number, String, isFinite});
