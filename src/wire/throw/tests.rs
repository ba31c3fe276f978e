use allocation_counter::measure;
use proptest::prelude::*;

use super::*;
use crate::throw::{Direction, ThrowRef, Trace};

fn example() -> Throw {
    Throw {
        id: ThrowRef { boot_id: "b-1".into(), throw_no: 7 },
        started_at: "2026-05-04T10:11:12.345678Z".parse().unwrap(),
        direction: Some(Direction::ReverseToNormal),
        trace: Trace::new(1000.0, vec![0.0, 1.5, -2.25], vec![115.0, 114.5, 114.0]).unwrap(),
        temperature_c: Some(-3.5),
        supply_v: None,
        anti_alias_hz: Some(400.0),
    }
}

const JSON: &str = r#"{"schema": "points.throw/1", "boot_id": "b", "throw_no": 1, "started_at": "2026-05-04T12:00:00+02:00",
    "sample_rate_hz": 100, "current_a": [0, 1, null], "position_mm": [0.5, 1, 2], "extra": {"deep": [1, {"x": []}]}}"#;

/// The same throw as [`example`].
const EXAMPLE: &str = r#"{"schema": "points.throw/1", "boot_id": "b-1", "throw_no": 7, "started_at": "2026-05-04T10:11:12.345678Z",
    "direction": "reverse_to_normal", "sample_rate_hz": 1000, "current_a": [0, 1.5, -2.25], "position_mm": [115, 114.5, 114],
    "temperature_c": -3.5, "anti_alias_hz": 400}"#;

fn messages() -> [(Encoding, Vec<u8>); 2] {
    [(Encoding::Cbor, encode_throw(&example())), (Encoding::Json, EXAMPLE.into())]
}

fn json(from: &str, to: &str) -> Result<Throw, Invalid> {
    assert!(JSON.contains(from), "{from} is not in the example");
    decode_throw(Encoding::Json, JSON.replace(from, to).as_bytes())
}

#[test]
fn both_encodings_carry_a_throw_unchanged() {
    for ((encoding, bytes), its_own) in messages().into_iter().zip(["application/cbor", "application/json"]) {
        for content_type in ["", "zenoh/bytes", "application/cbor", its_own] {
            assert_eq!(Encoding::of(content_type, &bytes), encoding);
        }
        assert_eq!(decode_throw(encoding, &bytes).unwrap(), example());
    }
}

#[test]
fn a_position_that_is_null_is_a_missing_one_in_both_encodings() {
    assert!(json("", "").unwrap().trace.has_position());
    assert!(!json("[0.5, 1, 2]", "null").unwrap().trace.has_position());
    let mut message = Encoder::new(Vec::new());
    let mut write = || -> Result<(), minicbor::encode::Error<std::convert::Infallible>> {
        message.map(7)?.str("schema")?.str("points.throw/1")?.str("boot_id")?.str("b")?.str("throw_no")?.u8(1)?;
        message.str("started_at")?.str("2026-05-04T10:00:00Z")?.str("sample_rate_hz")?.u8(100)?;
        message.str("current_a")?.array(2)?.f32(0.5)?.f32(1.0)?.str("position_mm")?.null()?;
        Ok(())
    };
    write().unwrap();
    let throw = decode_throw(Encoding::Cbor, &message.into_writer()).unwrap();
    assert!(!throw.trace.has_position() && throw.trace.current_a() == [0.5, 1.0]);
}

#[test]
fn json_from_other_languages_is_taken() {
    let throw = json("", "").unwrap();
    assert_eq!(throw.started_at, "2026-05-04T10:00:00Z".parse().unwrap());
    let exact = json("12:00:00+02:00", "12:00:00.123456789+02:00").unwrap();
    assert_eq!(exact.started_at, "2026-05-04T10:00:00.123456Z".parse().unwrap(), "as in the database");
    assert_eq!((throw.direction, throw.temperature_c), (None, None));
    assert_eq!(throw.trace.position_mm(), [0.5, 1.0, 2.0]);
    assert!(throw.trace.current_a()[2].is_nan());
    assert_eq!(json("\"throw_no\": 1", "\"throw_no\": 12.0").unwrap().id.throw_no, 12);
    assert_eq!(json("\"boot_id\"", "\"temperature_c\": null, \"boot_id\"").unwrap().temperature_c, None);
    let marked = format!("\u{feff}{JSON}").into_bytes();
    let decoded = decode_throw(Encoding::of("", &marked), &marked).unwrap();
    assert_eq!((decoded.id, decoded.direction), (throw.id, throw.direction), "with a byte order mark");
}

#[test]
fn the_supply_voltage_is_a_number_or_the_mean_of_samples_under_current() {
    let supply =
        |text: &str| json("\"boot_id\"", &format!("\"supply_v\": {text}, \"boot_id\"")).map(|throw| throw.supply_v);
    assert_eq!(supply("110.5").unwrap(), Some(110.5));
    assert_eq!(supply("null").unwrap(), None);
    // The currents are 0, 1 and not measured.
    assert_eq!(supply("[0, 108, 90]").unwrap(), Some(108.0));
    assert_eq!(supply("[110, null, null]").unwrap(), None);
    for (text, says) in [("[110, 108]", "2 values"), ("\"110\"", "must be a number"), ("[true]", "must be a number")] {
        let error = supply(text).unwrap_err().to_string();
        assert!(error.contains("supply_v") && error.contains(says), "{error}");
    }
    let two = cbor(|e| e.array(2)?.f32(1.0)?.f32(3.0)?.str("supply_v")?.array(2)?.f32(100.0)?.u8(120));
    assert_eq!(two.unwrap().supply_v, Some(115.0));
    let short = cbor(|e| e.array(2)?.f32(1.0)?.f32(3.0)?.str("supply_v")?.array(1)?.u8(120));
    assert!(short.unwrap_err().to_string().contains("1 values"));
}

#[test]
fn unusable_json_is_an_error_with_the_reason() {
    for (from, to, says) in [
        ("points.throw/1", "points.throw/9", "schema"),
        ("\"boot_id\": \"b\",", "", "boot_id is missing"),
        ("\"boot_id\": \"b\"", "\"boot_id\": \"\"", "boot_id"),
        ("\"throw_no\": 1", "\"throw_no\": -1", "throw_no: -1, must be a whole number from 0"),
        (
            "\"throw_no\": 1",
            "\"throw_no\": 1e18",
            "throw_no: 1e+18, must be a whole number from 0 to 2^63 - 1, above 2^53",
        ),
        ("\"throw_no\": 1", "\"throw_no\": 1.5", "throw_no: 1.5, must be a whole number from 0"),
        ("\"throw_no\": 1", "\"throw_no\": 9223372036854775808", "throw_no"),
        ("2026-05-04T12:00:00+02:00", "2026-05-04T12:00:00", "started_at"),
        ("2026-05-04T12:00:00+02:00", "yesterday", "started_at"),
        ("\"sample_rate_hz\": 100", "\"sample_rate_hz\": 0", "sample_rate_hz"),
        (
            "\"sample_rate_hz\": 100",
            "\"sample_rate_hz\": \"100\"",
            "sample_rate_hz: invalid type: string \"100\", must be a number",
        ),
        ("[0, 1, null]", "[0, 1]", "equally long"),
        ("[0, 1, null]", "[0, \"x\", 1]", "current_a: "),
        ("[0, 1, null]", "7", "array"),
        ("[0, 1, null]", "[0, NaN, 1]", "current_a: NaN is no JSON, write null"),
        ("[0, 1, null]", "[-Infinity, 0, 1]", "current_a: Infinity is no JSON"),
        ("\"sample_rate_hz\": 100", "\"sample_rate_hz\":Infinity", "sample_rate_hz: Infinity is no JSON"),
        ("\"boot_id\"", "\"direction\": \"left\", \"boot_id\"", "direction"),
        ("\"boot_id\"", "\"throw_no\": 3, \"boot_id\"", "duplicate"),
    ] {
        let error = json(from, to).unwrap_err().to_string();
        assert!(error.contains(says), "{to}: {error}");
    }
    let utf_16: Vec<u8> = format!("\u{feff}{JSON}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    let cbor = encode_throw(&example());
    for (bytes, first) in [(&utf_16[..], "0xff"), (&cbor, "0xa"), (b"[1]", "0x5b instead of {: JSON in UTF-8")] {
        let error = decode_throw(Encoding::Json, bytes).unwrap_err().to_string();
        assert!(error.contains(&format!("begins with the byte {first}")), "{error}");
    }
    for bytes in [&b""[..], b"{", b"[]", b"{} {}", b"nan", &b"[".repeat(100_000)] {
        assert!(decode_throw(Encoding::Json, bytes).is_err());
    }
}

/// Nested arrays would be a tree of many times the size of the message, and control characters in place of a value an
/// error of six times the size.
#[test]
fn no_json_takes_a_large_multiple_of_its_size() {
    let nested = format!("{{\"supply_v\":[{}]}}", vec!["[0]"; 1 << 18].join(","));
    let text = format!("\"{}\"", "\u{7f}".repeat(1 << 18));
    let fields = ["throw_no", "sample_rate_hz", "current_a", "temperature_c", "supply_v"];
    let of_text = fields.map(|field| format!("{{\"{field}\":{text}}}"));
    let of_texts = format!("{{\"supply_v\":[{text}]}}");
    for message in of_text.into_iter().chain([nested, of_texts, text]) {
        let taken = measure(|| {
            let error = decode_throw(Encoding::Json, message.as_bytes()).unwrap_err();
            assert!(error.to_string().len() < 512);
        });
        assert!(taken.bytes_max < 2 * message.len() as u64, "{}: {taken:?}", &message[..40]);
    }
}

/// The number of a rejected message is found, wherever its field is.
#[test]
fn a_message_that_is_no_throw_may_have_a_number() {
    let id = |from: &str, to: &str| throw_id(Encoding::Json, JSON.replace(from, to).as_bytes());
    let known = Some(ThrowRef { boot_id: "b".into(), throw_no: 1 });
    assert_eq!(id("[0, 1, null]", "[0, NaN, null]"), known);
    assert_eq!(id("\"sample_rate_hz\": 100", "\"sample_rate_hz\": \"100\""), known);
    for (from, to) in [
        ("\"boot_id\"", "\"boot\""),
        (": 1,", ": -1,"),
        (": 1,", ": 99999999999999999999,"),
        (": 1,", ": 1.5,"),
        (": 1,", ": 1e18,"),
        (": 1,", ": 1x,"),
    ] {
        assert_eq!(id(from, to), None, "{to}");
    }
    assert_eq!(id(": 1,", ": 1.0 ,"), known);
    assert_eq!(throw_id(Encoding::Json, b"{\"boot_id\": \"b\", \"throw_no\": 12"), None, "it may be cut");
    let mut cbor = encode_throw(&example());
    cbor.truncate(100);
    assert!(decode_throw(Encoding::Cbor, &cbor).is_err());
    assert_eq!(throw_id(Encoding::Cbor, &cbor), Some(example().id));
    assert_eq!(throw_id(Encoding::Cbor, b"x"), None);
}

type Encoder = minicbor::Encoder<Vec<u8>>;
type Written<'a> = Result<&'a mut Encoder, minicbor::encode::Error<std::convert::Infallible>>;

/// A message in CBOR with one channel written as `write` does.
fn cbor(write: impl for<'a> FnOnce(&'a mut Encoder) -> Written<'a>) -> Result<Throw, Invalid> {
    let mut encoder = Encoder::new(Vec::new());
    encoder.begin_map().unwrap();
    encoder.str("schema").unwrap().str("points.throw/1").unwrap();
    encoder.u8(9).unwrap().begin_array().unwrap().bool(true).unwrap().end().unwrap();
    encoder.str("boot_id").unwrap().begin_str().unwrap().str("b").unwrap().str("oot").unwrap().end().unwrap();
    encoder.str("throw_no").unwrap().u64(3).unwrap();
    encoder.str("started_at").unwrap().str("2026-05-04T10:00:00Z").unwrap();
    encoder.str("sample_rate_hz").unwrap().u16(1000).unwrap();
    encoder.str("position_mm").unwrap().array(2).unwrap().u8(1).unwrap().f32(2.5).unwrap();
    encoder.str("current_a").unwrap();
    write(&mut encoder).unwrap().end().unwrap();
    decode_throw(Encoding::Cbor, &encoder.into_writer())
}

#[test]
fn cbor_channels_may_be_plain_or_typed_arrays() {
    let little_endian = |values: [f64; 2]| values.map(f64::to_le_bytes).concat();
    let typed = cbor(|e| e.tag(minicbor::data::Tag::new(86))?.bytes(&little_endian([0.1, -7.0])));
    assert_eq!(typed.unwrap().trace.current_a(), [0.1, -7.0]);
    let plain = cbor(|e| e.begin_array()?.f64(0.1)?.i8(-7)?.end()).unwrap();
    assert_eq!(plain.trace.current_a(), [0.1, -7.0]);
    assert_eq!(plain.id.boot_id, "boot");
    assert_eq!(plain.trace.position_mm(), [1.0, 2.5]);
}

#[test]
fn unusable_cbor_is_an_error_with_the_reason() {
    let tag = minicbor::data::Tag::new;
    for (result, says) in [
        (cbor(|e| e.tag(tag(85))?.bytes(&[0; 7])), "whole number"),
        (cbor(|e| e.tag(tag(81))?.bytes(&[0; 8])), "tag 81"),
        (cbor(|e| e.tag(tag(85))?.u8(1)), "byte string"),
        (cbor(|e| e.str("1 2 3")), "a text, must be an array"),
        (cbor(|e| e.i8(-7)), "a negative number, must be an array"),
        (cbor(|e| e.f64(0.5)), "a floating-point number, must be an array"),
        (cbor(|e| e.array(1 << 60)), "samples"),
        (cbor(|e| e.array(900_000)), "must be a number"),
        (cbor(|e| e.array(1)?.str("x")), "must be a number"),
        (cbor(|e| e.array(1)?.u8(1)), "equally long"),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
    let mut trailing = encode_throw(&example());
    trailing.push(0);
    assert!(decode_throw(Encoding::Cbor, &trailing).unwrap_err().to_string().contains("1 bytes follow"));
    for deep in [0x9f, 0x81, 0xbf, 0xd8] {
        let mut message = vec![0xbf, 0x01];
        message.extend(std::iter::repeat_n(deep, 1_000_000));
        assert!(decode_throw(Encoding::Cbor, &message).is_err());
    }
}

proptest! {
    #[test]
    fn no_bytes_make_decoding_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        for encoding in [Encoding::Cbor, Encoding::Json] {
            drop(decode_throw(encoding, &bytes));
            drop(throw_id(encoding, &bytes));
        }
    }

    #[test]
    fn no_change_of_a_good_message_makes_decoding_panic(at in 0usize..400, byte in any::<u8>(), cut in 0usize..400) {
        for (encoding, mut bytes) in messages() {
            let at = at % bytes.len();
            bytes[at] = byte;
            drop(decode_throw(encoding, &bytes));
            bytes.truncate(cut);
            drop(decode_throw(encoding, &bytes));
        }
    }
}
