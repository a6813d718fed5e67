//! Bytes of a checkpoint. Reading never allocates more than the bytes at hand justify.

use super::{Array, Checkpoint, CheckpointError};

const MAGIC: &[u8; 8] = b"ECLIPSE\0";
const VERSION: u32 = 1;
/// No format will ever have a higher version: it is damage that says so.
const LAST_VERSION: u32 = 0xffff;
const HEADER: usize = 8 + 4 + 8 + 8;

/// The checkpoint as bytes; [`decode`] is the exact inverse.
pub fn encode(checkpoint: &Checkpoint) -> Vec<u8> {
    let mut payload = Vec::new();
    payload.extend(checkpoint.capture.to_le_bytes());
    payload.extend(checkpoint.iteration.to_le_bytes());
    payload.extend(checkpoint.seconds.to_le_bytes());
    // Settings hold strings, numbers and enums only, whose JSON cannot fail.
    put_bytes(
        &mut payload,
        &serde_json::to_vec(&checkpoint.settings).unwrap_or_default(),
    );
    payload.extend((checkpoint.arrays.len() as u64).to_le_bytes());
    for (name, array) in &checkpoint.arrays {
        put_bytes(&mut payload, name.as_bytes());
        let (kind, length) = match array {
            Array::F32(values) => (0u8, values.len()),
            Array::F64(values) => (1, values.len()),
            Array::U64(values) => (2, values.len()),
        };
        payload.push(kind);
        payload.extend((length as u64).to_le_bytes());
        match array {
            Array::F32(values) => values.iter().for_each(|v| payload.extend(v.to_le_bytes())),
            Array::F64(values) => values.iter().for_each(|v| payload.extend(v.to_le_bytes())),
            Array::U64(values) => values.iter().for_each(|v| payload.extend(v.to_le_bytes())),
        }
    }
    let mut bytes = Vec::with_capacity(HEADER + payload.len());
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((payload.len() as u64).to_le_bytes());
    bytes.extend(crc64(&payload).to_le_bytes());
    bytes.extend(payload);
    bytes
}

/// Reads what [`encode`] wrote.
///
/// # Errors
/// [`CheckpointError::Damaged`] for anything else, however hostile; [`CheckpointError::Version`] for other formats.
pub fn decode(bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let version = header(bytes)?;
    if version != VERSION {
        return Err(CheckpointError::Version {
            found: version,
            expected: VERSION,
        });
    }

    let mut reader = Reader { bytes, at: HEADER };
    let capture = reader.u64()?;
    let iteration = reader.u64()?;
    let seconds = f64::from_le_bytes(reader.array()?);
    let at = reader.at;
    let settings = serde_json::from_slice(reader.sized()?)
        .map_err(|error| damaged(at, format!("its settings cannot be read: {error}")))?;
    let count = reader.u64()?;
    let mut arrays = std::collections::BTreeMap::new();
    for _ in 0..count {
        let at = reader.at;
        let name = String::from_utf8(reader.sized()?.to_vec())
            .map_err(|_| damaged(at, "an array's name is not text"))?;
        let kind = reader.array::<1>()?[0];
        let length = reader.u64()?;
        let array = match kind {
            0 => Array::F32(reader.values(length, f32::from_le_bytes)?),
            1 => Array::F64(reader.values(length, f64::from_le_bytes)?),
            2 => Array::U64(reader.values(length, u64::from_le_bytes)?),
            other => {
                return Err(damaged(
                    at,
                    format!("array `{name}` has unknown type {other}"),
                ));
            }
        };
        if arrays.insert(name.clone(), array).is_some() {
            return Err(damaged(at, format!("array `{name}` appears twice")));
        }
    }
    if reader.at != bytes.len() {
        return Err(damaged(reader.at, "bytes are left over"));
    }
    Ok(Checkpoint {
        settings,
        capture,
        iteration,
        seconds,
        arrays,
    })
}

/// The version of a whole checkpoint. All versions begin alike, so that damage is told from a format of another program.
fn header(bytes: &[u8]) -> Result<u32, CheckpointError> {
    let mut header = Reader { bytes, at: 0 };
    if header.take(8)? != MAGIC {
        return Err(damaged(0, "it does not start as a checkpoint does"));
    }
    let at = header.at;
    let version = u32::from_le_bytes(header.array()?);
    if !(1..=LAST_VERSION).contains(&version) {
        return Err(damaged(at, format!("no format has the version {version}")));
    }
    let length = header.u64()?;
    let checksum = header.u64()?;
    let payload = &bytes[HEADER..];
    if payload.len() as u64 != length {
        let reason = format!("{length} bytes should follow, {} do", payload.len());
        return Err(damaged(HEADER, reason));
    }
    if crc64(payload) != checksum {
        return Err(damaged(HEADER, "the checksum does not match"));
    }
    Ok(version)
}

fn put_bytes(payload: &mut Vec<u8>, bytes: &[u8]) {
    payload.extend((bytes.len() as u64).to_le_bytes());
    payload.extend(bytes);
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], CheckpointError> {
        let end = self
            .at
            .checked_add(length)
            .filter(|&end| end <= self.bytes.len());
        let end = end.ok_or_else(|| damaged(self.at, "the file ends too early"))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CheckpointError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u64(&mut self) -> Result<u64, CheckpointError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn sized(&mut self) -> Result<&'a [u8], CheckpointError> {
        let length = self.u64()?;
        self.take(usize::try_from(length).unwrap_or(usize::MAX))
    }

    fn values<T, const N: usize>(
        &mut self,
        length: u64,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>, CheckpointError> {
        let bytes = usize::try_from(length)
            .ok()
            .and_then(|length| length.checked_mul(N));
        let bytes = self.take(bytes.unwrap_or(usize::MAX))?;
        let (chunks, _) = bytes.as_chunks::<N>();
        Ok(chunks.iter().map(|chunk| value(*chunk)).collect())
    }
}

fn damaged(offset: usize, reason: impl Into<String>) -> CheckpointError {
    CheckpointError::Damaged {
        offset,
        reason: reason.into(),
    }
}

/// CRC-64/XZ, which finds every burst error up to 64 bits.
pub(super) fn crc64(bytes: &[u8]) -> u64 {
    bytes.iter().fold(!0, |crc, &byte| {
        TABLE[((crc ^ u64::from(byte)) & 0xff) as usize] ^ (crc >> 8)
    }) ^ !0
}

static TABLE: [u64; 256] = {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u64;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 {
                (crc >> 1) ^ 0xc96c_5795_d787_0f42
            } else {
                crc >> 1
            };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksum_matches_the_published_check_value() {
        assert_eq!(crc64(b"123456789"), 0x995d_c9bb_df19_39fa);
    }
}
